"""The page of `viewnet demo`: an image and where its object is, and what a trained network makes of it.

Needs gradio, which is imported here: viewnet.commands.demo tells those who do not have it. What a visitor has
chosen is kept for that visitor alone (gr.State); the network is everybody's, and asked by one at a time.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

import gradio as gr
import numpy as np
from gradio.processing_utils import save_bytes_to_cache
from PIL import Image

from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator, volume_mesh
from viewnet.estimator.demo import analysis, compass_svg
from viewnet.estimator.demo.analysis import Inspection
from viewnet.estimator.demo.box_picker import Chosen, box_of, box_text, read
from viewnet.estimator.demo.examples import Example
from viewnet.model.reconstruction import Encoded

KEPT = 3600
"""Seconds for which files that visitors sent, and what was made of them, are kept."""
NETWORK = "network"
"""Events that ask the network wait for each other: compiled kernels are not for several threads at once."""
HINT = "Click two opposite corners of the object in the image, or type its edges in pixels."
WAITING = "<p>Choose an image, say where its object is, and press <b>Find the viewpoint</b>.</p>"
STYLE = """
.gradio-container { max-width: 1180px !important; margin: auto; }
.dials { display: flex; gap: 8px; flex-wrap: wrap; justify-content: center; }
.dials figure { flex: 1 1 145px; max-width: 300px; margin: 0; text-align: center; }
.dials svg { width: 100%; height: auto; }
.headline { font-size: 1.25em; margin: 0.2em 0; }
.notes { margin: 0.4em 0 0 1.2em; list-style: disc; }
#hypotheses table { width: 100%; border-collapse: collapse; margin: 0; }
#hypotheses :is(table, tr, th, td) { border: 0 !important; text-align: left; font-weight: normal; }
#hypotheses :is(th, td) { padding: 3px 8px 3px 0; }
#hypotheses thead th { opacity: 0.75; font-size: 0.85em; }
#hypotheses td.bars { width: 34%; }
#examples .grid-container { grid-template-columns: repeat(4, minmax(0, 1fr)); }
#examples .gallery-item, #examples button { min-width: 0; width: 100%; height: auto; aspect-ratio: 1; }
#hypotheses .bar { display: block; height: 12px; min-width: 1px; border-radius: 3px; }
"""


def theme() -> gr.themes.Base:
    """Gradio's with the reader's own fonts: none are fetched; in a blue on which white letters can be read."""
    return gr.themes.Default(
        primary_hue="blue", font=("system-ui", "sans-serif"), font_mono=("ui-monospace", "monospace")
    )


def build(estimator: ViewpointEstimator, examples: Sequence[Example] = ()) -> gr.Blocks:
    """The page of a network, with images to try it on."""
    return Page(estimator, examples).blocks


class Page:
    """Components and what happens between them; what visitors do goes from event to event and is never kept here."""

    def __init__(self, estimator: ViewpointEstimator, examples: Sequence[Example]):
        self.estimator, self.examples = estimator, list(examples)
        self.folder = tempfile.TemporaryDirectory(prefix="viewnet-demo-")  # of the examples' files, as long as the page
        title = f"From where is this {estimator.config.category} seen?"
        with gr.Blocks(title=title, analytics_enabled=False, delete_cache=(KEPT, KEPT)) as self.blocks:
            self.chosen, self.encoded = (gr.State(None, time_to_live=KEPT) for _ in range(2))
            gr.Markdown(f"# {title}")
            with gr.Row():
                with gr.Column(scale=5, min_width=320):
                    self._lay_out_question()
                with gr.Column(scale=6, min_width=320):
                    self._lay_out_answer()
            with gr.Row():
                with gr.Column(min_width=320):
                    self._lay_out_views()
                with gr.Column(min_width=320):
                    self.mesh = gr.Model3D(
                        label="As a 3-D model: drag to turn it", clear_color=(1, 1, 1, 1), height=440, elem_id="mesh"
                    )
            with gr.Accordion("What this model is", open=True):
                gr.Markdown("\n".join(f"- {line}" for line in analysis.about(estimator)), elem_id="about")
            self._connect()

    def _lay_out_question(self) -> None:
        self.image = gr.Image(
            label="Image: drop, paste or take one",
            sources=["upload", "webcam", "clipboard"],
            height=320,
            elem_id="picture",
        )
        gr.Markdown(HINT)
        self.box = gr.Textbox(label="Box: left, top, right, bottom", placeholder="40 60 380 250", elem_id="box")
        with gr.Row():
            self.unbox = gr.Button("No box", min_width=100, elem_id="unbox")
            self.find = gr.Button("Find the viewpoint", variant="primary", min_width=180, elem_id="find")
        with gr.Accordion("A mask instead", open=False, elem_id="mask-panel"):
            gr.Markdown("An image of the same size, the object white. Transparency is a mask too, without this one.")
            self.mask = gr.Image(label="Mask", sources=["upload", "clipboard"], height=200, elem_id="mask")
        if self.examples:
            files = [Path(self.folder.name) / f"example{number}.png" for number in range(len(self.examples))]
            for file, example in zip(files, self.examples, strict=True):
                example.image.save(file)
            self.files = files
            self.samples = gr.Gallery(
                [str(file) for file in files],
                label="Or one of these, which it was not trained on",
                columns=len(files),
                rows=1,
                height=130,
                object_fit="contain",
                allow_preview=False,
                interactive=False,
                buttons=[],
                elem_id="examples",
            )

    def _lay_out_answer(self) -> None:
        self.answer = gr.HTML(WAITING, elem_id="answer")
        with gr.Row():
            still: dict[str, Any] = {
                "interactive": False,
                "format": "png",
                "height": 230,
                "min_width": 130,
                "buttons": [],
            }
            self.seen = gr.Image(label="As the network sees it", elem_id="seen", **still)
            self.posed = gr.Image(label="As it draws it from there", elem_id="posed", **still)
        self.table = gr.HTML(elem_id="hypotheses")

    def _lay_out_views(self) -> None:
        self.view = gr.Image(
            label="From elsewhere", interactive=False, format="png", height=300, buttons=["download"], elem_id="view"
        )
        self.azimuth = gr.Slider(0, 360, value=0, step=1, label="azimuth, degrees", elem_id="azimuth")
        self.elevation = gr.Slider(-90, 90, value=0, step=1, label="elevation, degrees", elem_id="elevation")

    def _connect(self) -> None:
        question = [self.chosen, self.image, self.box]
        answer = [self.encoded, self.answer, self.seen, self.posed, self.table]
        answer += [self.azimuth, self.elevation, self.view, self.mesh]
        quiet: dict[str, Any] = {"api_visibility": "private", "show_progress": "hidden"}
        alone: dict[str, Any] = {"concurrency_id": NETWORK, "concurrency_limit": 1, "api_visibility": "private"}
        raw: dict[str, Any] = alone | {"preprocess": False}
        asking = (self.ask, [self.chosen, self.mask, self.box], answer)
        # Files come as they are (preprocess): the project's own reader, and not gradio's, says what is wrong with one.
        self.image.input(self.take, self.image, question + answer, preprocess=False, **quiet)
        self.image.select(self.click, self.chosen, question, **quiet)
        self.box.input(self.redraw, [self.chosen, self.box], self.image, trigger_mode="always_last", **quiet)
        self.box.submit(*asking, **raw)
        self.unbox.click(self.forget_box, self.chosen, question, **quiet)
        self.find.click(*asking, **raw)
        for slider in (self.azimuth, self.elevation):
            given = [self.encoded, self.azimuth, self.elevation]
            slider.input(self.turn, given, self.view, trigger_mode="always_last", show_progress="hidden", **alone)
        if self.examples:
            tried = self.samples.select(self.try_example, None, [*question, self.mask], **quiet)
            tried.success(*asking, **raw)

    def take(self, sent: dict[str, Any] | None) -> Iterator[list[Any]]:
        """A visitor's image came, or was taken away: whatever was said of another one goes."""
        file = _file_of(sent)
        nothing = ["", None, WAITING, None, None, None, 0, 0, None, None]
        try:
            chosen = None if file is None else Chosen.of(*file)
        except ViewnetError as error:
            yield [None, None, *nothing]
            raise _toast(error) from None
        yield [chosen, None if chosen is None else chosen.shown(), *nothing]

    def click(self, chosen: Chosen | None, event: gr.SelectData) -> list[Any]:
        """A corner of the box: the first, or the one that ends it."""
        if chosen is None:
            return [gr.skip()] * 3
        chosen, box = chosen.clicked(*event.index)
        return [chosen, chosen.shown(box), box_text(box)]

    def redraw(self, chosen: Chosen | None, text: str) -> Any:
        """The image with the box as far as it is typed."""
        if chosen is None:
            return gr.skip()
        try:
            return chosen.clear().shown(box_of(text))
        except ViewnetError:  # told when the network is asked
            return chosen.shown()

    def forget_box(self, chosen: Chosen | None) -> list[Any]:
        """All of the image is the object."""
        chosen = None if chosen is None else chosen.clear()
        return [chosen, gr.skip() if chosen is None else chosen.shown(), ""]

    def try_example(self, event: gr.SelectData) -> list[Any]:
        """An example's image and box; no mask."""
        number = event.index
        chosen, box = Chosen.of(self.files[number], f"example {number + 1}"), self.examples[number].box
        return [chosen, chosen.shown(box), box_text(box), None]

    def ask(self, chosen: Chosen | None, mask: dict[str, Any] | None, box: str) -> list[Any]:
        """What the network says of the image. What is wrong with what was given is a toast, and no ViewnetError."""
        try:
            if chosen is None:
                raise ViewnetError("no image: drop, paste or take one, or choose an example")
            file = _file_of(mask)
            alpha = None if file is None else read(file[0], f"mask {file[1]}")
            known = (chosen.image(), alpha, box_of(box))
            found = analysis.inspect(self.estimator, *known)
        except ViewnetError as error:
            raise _toast(error) from None
        notes, model, reach = list(found.notes), None, 1.0
        try:
            mesh = self.estimator.mesh(*known)
            model = save_bytes_to_cache(volume_mesh.as_glb(mesh), "object.glb", self.mesh.GRADIO_CACHE)
            reach = float(np.linalg.norm(mesh.vertices, axis=1).max())
        except ViewnetError as error:
            notes.append(f"There is no 3-D model: {error}.")
        one = found.viewpoint
        azimuth, elevation = round(one.azimuth) % 360, round(one.elevation)
        told = answer(found, notes)
        shown = gr.update(value=model, camera_position=_camera(azimuth, elevation, reach))
        view = self.turn(found.encoded, azimuth, elevation)
        return [
            found.encoded,
            told,
            _enlarged(found.seen),
            found.posed,
            compass_svg.table(one),
            azimuth,
            elevation,
            view,
            shown,
        ]

    def turn(self, encoded: Encoded | None, azimuth: float, elevation: float) -> Any:
        """The object from a viewpoint of the visitor's."""
        return gr.skip() if encoded is None else analysis.novel_view(self.estimator, encoded, azimuth, elevation)


def _file_of(sent: dict[str, Any] | None) -> tuple[Path, str] | None:
    """A file that a visitor sent, whatever is in it, and the name that it had there."""
    if not sent or not sent.get("path"):
        return None
    return Path(sent["path"]), sent.get("orig_name") or Path(sent["path"]).name


def answer(found: Inspection, notes: Sequence[str]) -> str:
    """HTML: the viewpoint in numbers, in words where its frame is the annotated one, and as two dials."""
    one = found.viewpoint
    words = f": it shows {compass_svg.words(one.azimuth, one.elevation)}" if one.aligned else ""
    frame = "" if one.aligned else "<p>In the model's own frame: azimuth 0 and up are arbitrary.</p>"
    listed = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return (
        f'<p class="headline">azimuth <b>{one.azimuth:.1f}°</b>, elevation <b>{one.elevation:.1f}°</b>{words}</p>'
        f"<p>confidence <b>{100 * one.confidence:.1f} %</b>: the probability that this hypothesis "
        f"is the best one, as the network sees it</p>{frame}"
        f'<div class="dials"><figure>{compass_svg.from_above(one)}<figcaption>from above</figcaption></figure>'
        f"<figure>{compass_svg.from_the_side(one)}<figcaption>from the side</figcaption></figure></div>"
        + (f'<ul class="notes">{listed}</ul>' if notes else "")
    )


def _enlarged(pixels: np.ndarray) -> Image.Image:
    """Of the few pixels that a network sees, each as a square."""
    times = max(1, analysis.SIZE // len(pixels))
    image = Image.fromarray(pixels)
    return image.resize((times * image.width, times * image.height), Image.Resampling.NEAREST)


def _camera(azimuth: float, elevation: float, reach: float) -> tuple[float, float, float]:
    """Where the browser's 3-D viewer is to look from, and how far from an object that reaches so far from its centre.

    It counts azimuths the other way round, and elevations from above. All of the object is seen on a narrow screen.
    """
    return -azimuth, min(max(90.0 - elevation, 1.0), 179.0), 3.4 * reach


def _toast(error: ViewnetError) -> gr.Error:
    return gr.Error(escape(str(error)), title="That does not work", print_exception=False)
