"""What the page shows of one image, and the facts about the network beside it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from viewnet.data.crop import reaches_far_beyond
from viewnet.estimator import ViewpointEstimator, inputs, model_card, preprocess, templating
from viewnet.estimator.viewpoints import Viewpoint
from viewnet.evaluation.symmetry import symmetry
from viewnet.geometry import look_at, view_vector
from viewnet.model import rendering
from viewnet.model.reconstruction import Encoded
from viewnet.render import render_mesh
from viewnet.render.mesh import Material, Mesh

if TYPE_CHECKING:
    import trimesh

SIZE = 256  # pixels along a side of rendered images, about


@dataclass(frozen=True, eq=False)
class Analysis:
    """What a network predicts and renders for one image."""

    viewpoint: Viewpoint
    prepared: preprocess.Prepared  # the image as the network sees it
    reconstruction: np.ndarray  # (S, S, 3) uint8, rendered from the predicted viewpoint
    encoded: Encoded  # the object, for `novel_view`
    notes: tuple[str, ...]  # reasons not to trust the prediction, a sentence each

    @property
    def input(self) -> np.ndarray:
        """(S, S, 3) uint8, what the network sees of the image."""
        return rendering.to_uint8(self.prepared.images)[0]


def analyse(estimator: ViewpointEstimator, image: inputs.ImageLike, mask: Any = None, box: Any = None) -> Analysis:
    """Analyse one image. ViewnetError for an image, mask or box that cannot be used."""
    framing = estimator.framing
    given = inputs.read_image(image, mask, inputs.boxes_of([box], 1)[0])
    prepared = preprocess.prepare([preprocess.crop_to_object(given, framing)], framing, estimator.device)
    notes = []
    if box is None and not prepared.masked[0]:
        notes.append("Neither box nor mask was given: the whole image is taken for the object.")
    if box is not None and reaches_far_beyond(inputs.box_of(box), given.image.size):
        notes.append("Most of the box lies outside of the image: only what lies in it is used.")
    if framing.cutout and not prepared.cutout[0]:
        notes.append("This model has only seen cut-out objects on black: give a mask or a transparent image.")
    elif framing.rendered and (mask is not None or box is not None):
        views = "This model was trained on whole views as a rendering camera frames them"
        notes.append(f"{views}: its predictions for images that are cut are unreliable.")
    reconstruction = estimator.reconstruct(prepared, size=_size(estimator))[0]
    viewpoint, encoded = estimator.predict(prepared)[0], estimator.encode(prepared)
    return Analysis(viewpoint, prepared, reconstruction, encoded, tuple(notes))


def novel_view(estimator: ViewpointEstimator, encoded: Encoded, azimuth: float, elevation: float) -> np.ndarray:
    """(S, S, 3) uint8: an encoded object from another viewpoint, as ViewpointEstimator.novel_view renders it."""
    angles = (torch.tensor([value], dtype=torch.float64) for value in (azimuth, elevation))
    pose = estimator.in_own_frame(look_at(view_vector(*angles)))
    return np.asarray(estimator.displayed(estimator.render(encoded, pose, _size(estimator)))[0])


def four_sides(mesh: "trimesh.Trimesh", azimuth: float, elevation: float) -> np.ndarray:
    """(2 S, 2 S, 3) uint8: a coloured mesh on white from a viewpoint, and a quarter, a half and three quarters on."""
    vertices = mesh.vertices / (2 * np.linalg.norm(mesh.vertices, axis=1).max())
    material = np.zeros(len(mesh.faces), np.int32)
    visual: Any = mesh.visual
    colours = (visual.vertex_colors[mesh.faces][..., :3] / 255).astype(np.float32)
    drawn = Mesh(vertices, mesh.faces.astype(np.int32), material, (Material(),), colours=colours)
    views = render_mesh(drawn, (azimuth + 90 * np.arange(4)) % 360, np.full(4, float(elevation)), SIZE)
    share = views[..., 3:] / 255
    on_white = (views[..., :3] * share + 255 * (1 - share)).round().astype(np.uint8)
    return on_white.reshape(2, 2, SIZE, SIZE, 3).swapaxes(1, 2).reshape(2 * SIZE, 2 * SIZE, 3)


def model_facts(estimator: ViewpointEstimator) -> str:
    """What to know of the network when reading its predictions: a list in Markdown."""
    about = estimator.about
    scores = model_card.own(about.get("metrics") or {})
    scored = [("test views of objects not used in training", scores)] if scores else []
    scored += [(other["on"], next(iter(other["alignments"].values()))) for other in about.get("scores") or []]
    known = {"alike": symmetry(estimator.config.category).note, "scored": scored[::-1]}
    return templating.rendered("model_facts.md", estimator=estimator, config=estimator.config, **known)


def _size(estimator: ViewpointEstimator) -> int | None:
    """A whole multiple of the size that the network renders."""
    trained = estimator.network.config.render_size
    return max(1, round(SIZE / trained)) * trained
