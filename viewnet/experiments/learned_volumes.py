"""Files of learned volumes: coloured meshes and turntables of the first test object of each run."""

from collections.abc import Sequence
from pathlib import Path

from viewnet.estimator import turntable, volume_mesh
from viewnet.evaluation.run import Run
from viewnet.tables import run_renderer


def write(runs: Sequence[Run], folder: Path) -> tuple[list[Path], list[Path]]:
    """A mesh in `meshes/<category>/` (GLB) and a turntable (GIF) a run, which begins at the predicted viewpoint."""
    meshes, turntables = [], []
    for renderer in run_renderer.renderers(runs):
        category, ids = renderer.config.category, renderer.aligned.predictions.ids.iloc[0]
        encoded = renderer.encode([0])
        mesh = volume_mesh.surface(encoded.volume[0], renderer.rotation)
        meshes.append(volume_mesh.write(mesh, folder / "meshes" / category / f"{ids['model_id']}-{ids['view']}.glb"))
        image, frame = renderer.test_images([0])[0], renderer.predicted_frames([0])[0]
        images = turntable.animate(renderer, image, encoded, frame)
        turntables.append(turntable.save(images, folder / f"turntable_{category}.gif"))
    return meshes, turntables
