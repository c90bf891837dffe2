"""The page of `viewnet demo`: an image and the place of its object, and what a trained network predicts and renders.

Needs gradio. What a visitor chose is kept for that visitor (gr.State); one event at a time uses the shared network.
"""

import tempfile
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

import gradio as gr
import numpy as np
from gradio.processing_utils import save_bytes_to_cache
from gradio.utils import get_upload_folder, is_in_or_equal
from PIL import Image

from viewnet.data import mask_files
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator, templating, volume_mesh
from viewnet.estimator.demo import analysis, compass_svg
from viewnet.estimator.demo.box_picker import BoxPicker, format_box, parse_box
from viewnet.estimator.demo.examples import Example
from viewnet.model.kernels import volume_cpu
from viewnet.model.reconstruction import Encoded

LIFETIME = 3600  # seconds after which files that visitors sent, and what was made of them, are deleted
WAITING = "<p>Choose an image, say where its object is, and press <b>Find the viewpoint</b>.</p>"
NOTHING = (None, WAITING, None, None, None, 0, 0, None, None, None)  # in place of an answer
SENT = "what was sent is not what this page sends: load the page again"
# Whether a browser draws in 3-D not at all, or without a graphics card, and so in seconds.
WITHOUT_3D = """() => {
    const context = document.createElement("canvas").getContext("webgl2");
    const card = context && context.getExtension("WEBGL_debug_renderer_info");
    const name = context && context.getParameter(card ? card.UNMASKED_RENDERER_WEBGL : context.RENDERER);
    return !context || /swiftshader|llvmpipe|software/i.test(name);
}"""
DRAWN = "Or take one of these drawn ones, which it was not trained on. Photographs are harder."
STYLE = Path(__file__).parents[1] / "templates" / "demo.css"


def theme() -> gr.themes.Base:
    """Gradio's default with the visitor's own fonts, none of which is fetched, and a blue that contrasts with white."""
    fonts: Any = {"font": ("system-ui", "sans-serif"), "font_mono": ("ui-monospace", "monospace")}
    return gr.themes.Default(primary_hue="blue", **fonts)


class _Blocks(gr.Blocks):
    """Blocks that refuse forged inputs, such as paths that are no uploads, with a toast and without a traceback."""

    async def preprocess_data(self, *arguments: Any, **options: Any) -> Any:
        """As gr.Blocks, but for the error of inputs that gradio refuses."""
        try:
            return await super().preprocess_data(*arguments, **options)
        except ValueError:
            raise _toast(ViewnetError(SENT)) from None


class Page:
    """The page of a network, with images to try it on: components (`blocks`) and event handlers, without any state."""

    def __init__(self, estimator: ViewpointEstimator, examples: Sequence[Example] = ()):
        self.estimator, self.examples = estimator, list(examples)
        volume_cpu.warm_up()  # before the first visitor: a new installation compiles its kernels
        self.folder = tempfile.TemporaryDirectory(prefix="viewnet-demo-")  # of the examples' files, as long as the page
        title = f"From where is this {estimator.config.category} seen?"
        with _Blocks(title=title, analytics_enabled=False, delete_cache=(LIFETIME, LIFETIME)) as self.blocks:
            self.picker, self.encoded = (gr.State(None, time_to_live=LIFETIME) for _ in range(2))
            self.without_3d = gr.Checkbox(False, visible=False)
            gr.Markdown(f"# {title}")
            with gr.Row():
                with gr.Column(scale=5, min_width=320):
                    self._lay_out_question()
                with gr.Column(scale=6, min_width=320):
                    self._lay_out_answer()
            with gr.Row():
                self._lay_out_views()
            with gr.Accordion("What this model is", open=True):
                gr.Markdown(analysis.model_facts(estimator), elem_id="about")
            self._connect()

    def _lay_out_question(self) -> None:
        sources: Any = ["upload", "webcam", "clipboard"]
        self.image = gr.Image(label="Image: drop, paste or take one", sources=sources, height=320, elem_id="image")
        gr.Markdown("Click two opposite corners of the object in the image, or type its edges in pixels.")
        self.box = gr.Textbox(label="Box: left, top, right, bottom", placeholder="40 60 380 250", elem_id="box")
        with gr.Row():
            self.unbox = gr.Button("No box", min_width=100, elem_id="unbox")
            self.find = gr.Button("Find the viewpoint", variant="primary", min_width=180, elem_id="find")
        with gr.Accordion("A mask instead", open=False, elem_id="mask-panel"):
            gr.Markdown("An image of the same size, the object white. Without one, transparency is the mask.")
            self.mask = gr.Image(label="Mask", sources=["upload", "clipboard"], height=200, elem_id="mask")
        if self.examples:
            self.files = [Path(self.folder.name) / f"example{number}.png" for number in range(len(self.examples))]
            for file, example in zip(self.files, self.examples, strict=True):
                example.image.save(file)
            layout: dict[str, Any] = {"columns": len(self.files), "rows": 1, "height": 130, "object_fit": "contain"}
            layout |= {"allow_preview": False, "interactive": False, "buttons": [], "elem_id": "examples"}
            gr.Markdown(DRAWN if self.examples[0].drawn else "Or take one of these.")
            label = "Examples"
            self.samples = gr.Gallery([str(file) for file in self.files], label=label, show_label=False, **layout)

    def _lay_out_answer(self) -> None:
        self.answer = gr.HTML(WAITING, elem_id="answer")
        with gr.Row():
            still: Any = {"interactive": False, "format": "png", "buttons": [], "height": 230, "min_width": 130}
            self.input = gr.Image(label="As the network sees it", elem_id="seen", **still)
            self.reconstruction = gr.Image(label="As it renders it from there", elem_id="posed", **still)
        self.table = gr.HTML(elem_id="hypotheses")

    def _lay_out_views(self) -> None:
        still: Any = {"interactive": False, "format": "png", "buttons": ["download"]}
        with gr.Column(min_width=320):
            self.view = gr.Image(label="From elsewhere", height=300, elem_id="view", **still)
            self.azimuth = gr.Slider(0, 360, value=0, step=1, label="azimuth, degrees", elem_id="azimuth")
            self.elevation = gr.Slider(-90, 90, value=0, step=1, label="elevation, degrees", elem_id="elevation")
        with gr.Column(min_width=320):
            label, white = "As a 3-D model: drag to turn it", (1, 1, 1, 1)
            self.mesh = gr.Model3D(label=label, clear_color=white, height=440, elem_id="mesh")
            label = "As a 3-D model, from four sides: this browser cannot turn it"
            self.sides = gr.Image(label=label, height=440, elem_id="sides", visible=False, **still)

    def _connect(self) -> None:
        question = [self.picker, self.image, self.box]
        answer = [self.encoded, self.answer, self.input, self.reconstruction, self.table]
        answer += [self.azimuth, self.elevation, self.view, self.mesh, self.sides]
        quiet: dict[str, Any] = {"api_visibility": "private", "show_progress": "hidden"}
        # Events that use the network wait for each other: compiled kernels are not for several threads at once.
        queued: dict[str, Any] = {"concurrency_id": "network", "concurrency_limit": 1, "api_visibility": "private"}
        # Files come as they are (preprocess=False): the project's own reader, not gradio's, explains what is wrong.
        raw: dict[str, Any] = queued | {"preprocess": False}
        predicting = (self.predict, [self.picker, self.mask, self.box, self.without_3d], answer)
        self.blocks.load(None, None, self.without_3d, js=WITHOUT_3D)
        self.image.input(self.take, self.image, question + answer, preprocess=False, **quiet)
        self.image.select(self.click, self.picker, question, **quiet)
        self.box.input(self.redraw, [self.picker, self.box], self.image, trigger_mode="always_last", **quiet)
        asked = [self.box.submit(*predicting, **raw), self.find.click(*predicting, **raw)]
        self.unbox.click(self.forget_box, self.picker, question, **quiet)
        for slider in (self.azimuth, self.elevation):
            angles = [self.encoded, self.azimuth, self.elevation]
            slider.input(self.turn, angles, self.view, trigger_mode="always_last", show_progress="hidden", **queued)
        if self.examples:
            chosen = self.samples.select(self.try_example, None, [*question, self.mask], **quiet)
            asked.append(chosen.success(*predicting, **raw))
        for each in asked:
            each.failure(lambda: list(NOTHING), None, answer, **quiet)

    def take(self, sent: dict[str, Any] | None) -> Iterator[list[Any]]:
        """A visitor sent an image, or removed it: clear the box and the answer."""
        try:
            file = _file_of(sent)
            picker = None if file is None else BoxPicker.of(*file)
        except ViewnetError as error:
            yield [None, None, "", *NOTHING]
            raise _toast(error) from None
        yield [picker, None if picker is None else picker.shown(), "", *NOTHING]

    def click(self, picker: BoxPicker | None, event: gr.SelectData) -> list[Any]:
        """A corner of the box: the first, or the one that completes it."""
        if picker is None:
            return [gr.skip()] * 3
        picker, box = picker.click(*event.index)
        return [picker, picker.shown(box), format_box(box)]

    def redraw(self, picker: BoxPicker | None, text: str) -> Any:
        """The image with the box as far as it is typed."""
        if picker is None:
            return gr.skip()
        try:
            return picker.clear().shown(parse_box(text))
        except ViewnetError:  # reported once the prediction is asked for
            return picker.shown()

    def forget_box(self, picker: BoxPicker | None) -> list[Any]:
        """No box: the whole image is the object."""
        picker = None if picker is None else picker.clear()
        return [picker, gr.skip() if picker is None else picker.shown(), ""]

    def try_example(self, event: gr.SelectData) -> list[Any]:
        """An example's image and box; no mask."""
        number = event.index
        picker, box = BoxPicker.of(self.files[number], f"example {number + 1}"), self.examples[number].box
        return [picker, picker.shown(box), format_box(box), None]

    def predict(
        self, picker: BoxPicker | None, mask: dict[str, Any] | None, box: str, without_3d: bool = False
    ) -> list[Any]:
        """What the network predicts and renders for the image. A mistake (ViewnetError) becomes a toast.

        `without_3d`: a picture in place of the 3-D model, for browsers that cannot draw it soon.
        """
        try:
            if picker is None:
                raise ViewnetError("no image: drop, paste or take one, or choose an example")
            file = _file_of(mask)
            alpha = None if file is None else mask_files.read(file[0], f"mask {file[1]}")
            result = analysis.analyse(self.estimator, picker.image(), alpha, parse_box(box))
        except ViewnetError as error:
            raise _toast(error) from None
        notes, model, sides, reach = list(result.notes), None, None, 1.0
        viewpoint = result.viewpoint
        azimuth, elevation = round(viewpoint.azimuth) % 360, round(viewpoint.elevation)
        try:
            mesh = self.estimator.mesh(result.prepared)
            reach = float(np.linalg.norm(mesh.vertices, axis=1).max())
            if without_3d:
                sides = analysis.four_sides(mesh, azimuth, elevation)
            else:
                model = save_bytes_to_cache(volume_mesh.as_glb(mesh), "object.glb", self.mesh.GRADIO_CACHE)
        except ViewnetError as error:
            notes.append(f"There is no 3-D model: {error}.")
        times = max(1, analysis.SIZE // len(result.input))  # each of the few pixels as a square
        images = [Image.fromarray(result.input.repeat(times, 0).repeat(times, 1)), result.reconstruction]
        view = self.turn(result.encoded, azimuth, elevation)
        # The viewer counts azimuths clockwise and elevations from above; the distance suits narrow screens.
        camera = (-azimuth, min(max(90.0 - elevation, 1.0), 179.0), 3.4 * reach)
        turned = gr.update(value=model, camera_position=camera, visible=not without_3d)
        drawn = gr.update(value=sides, visible=without_3d)
        hypotheses = compass_svg.table(viewpoint)
        return [result.encoded, answer(result, notes), *images, hypotheses, azimuth, elevation, view, turned, drawn]

    def turn(self, encoded: Encoded | None, azimuth: float, elevation: float) -> Any:
        """The object from the viewpoint of the sliders."""
        return gr.skip() if encoded is None else analysis.novel_view(self.estimator, encoded, azimuth, elevation)


def _file_of(sent: dict[str, Any] | None) -> tuple[Path, str] | None:
    """A file that a visitor sent, whatever its contents, and its name on the visitor's machine.

    ViewnetError for a path that is no upload: gradio checks only those that are marked as files.
    """
    if not sent or not sent.get("path"):
        return None
    if not is_in_or_equal(sent["path"], get_upload_folder()):
        raise ViewnetError(SENT)
    return Path(sent["path"]), sent.get("orig_name") or Path(sent["path"]).name


def answer(result: analysis.Analysis, notes: Sequence[str]) -> str:
    """HTML: the viewpoint in numbers, in words if it is in the annotated frame, and on two compasses."""
    one = result.viewpoint
    above, side = compass_svg.from_above(one), compass_svg.from_the_side(one)
    rival = one.rival
    words = ", or ".join(compass_svg.words(each.azimuth, each.elevation) for each in (one, rival) if each)
    return templating.rendered("answer.html", one=one, rival=rival, words=words, above=above, side=side, notes=notes)


def _toast(error: ViewnetError) -> gr.Error:
    return gr.Error(escape(str(error)), title="That does not work", print_exception=False)
