"""The page that needs no server, driven in a browser, if there is one (Debian: apt-get install chromium npm)."""

from __future__ import annotations

import functools
import http.server
import json
import re
import shutil
import struct
import threading
import time
import zlib
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from helpers.browser import Visitor, chromium
from helpers.documents import script
from PIL import Image

from viewnet import cli
from viewnet.data.crop import Crop, cut
from viewnet.errors import ViewnetError
from viewnet.estimator import ViewpointEstimator
from viewnet.estimator.camera_axes import MEANINGS
from viewnet.estimator.inputs import read_image
from viewnet.estimator.preprocess import crop_to_object, prepare
from viewnet.estimator.pretrained import shipped

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
CAR = ROOT / "docs" / "car.jpg"
NOTHING = "\u2013"  # a dash, in place of a number
EXACT = 0.002  # degrees, and points of probability, for images that are decoded and cut alike
ALIKE = 0.1  # degrees, for JPEG, of which browsers may decode pixels a grey level apart

build = script("build", "web")
BOX = tuple(build.EXAMPLE["box"])


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The page, built without the network."""
    found = tmp_path_factory.mktemp("web") / "page"
    packages = found.with_name("page-npm")
    try:
        build.installed(packages, offline=True)
    except SystemExit as reason:
        pytest.skip(f"{reason}")
    build.build(found, offline=True)
    yield found
    shutil.rmtree(packages)


@pytest.fixture(scope="module")
def address(folder):
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.fixture(scope="module")
def browser():
    with chromium() as found:
        yield found


class Visit(Visitor):
    READY = "body[data-ready]"

    def settle(self):
        self.tab.locator("#answer[aria-busy=false]").wait_for()

    def send(self, file):
        self.tab.locator("#file").set_input_files(file)
        self.settle()

    def frame(self, box):
        """Type a box; the answer is that of its last number."""
        for name, value in zip(("x0", "y0", "x1", "y1"), box, strict=True):
            self.tab.locator(f"#box [name={name}]").fill(str(value))
        self.tab.locator("#box [name=y1]").press("Tab")
        self.settle()

    def choose(self, model):
        self.tab.locator("#model").select_option(model)
        self.settle()

    def number(self, name):
        return float(self.tab.locator(f"#{name}").get_attribute("value"))

    @property
    def angles(self):
        return self.number("azimuth"), self.number("elevation")

    @property
    def hypotheses(self):
        """Azimuth, elevation and probability in % of each, as shown."""
        rows = [row.split("\t") for row in self.tab.locator("#hypotheses tbody tr").all_inner_texts()]
        return [[float(re.match(r"-?[\d.]+", cell.strip())[0]) for cell in row[1:4]] for row in rows]

    def matrix(self, frame):
        self.tab.locator("#frame").select_option(frame)
        return np.array(self.tab.locator("#matrix td").all_inner_texts(), float).reshape(3, 3)

    @property
    def message(self):
        return self.tab.locator("#message").inner_text()

    @property
    def empty(self):
        """Whether no answer is shown."""
        shown = self.tab.locator("dd, #hypotheses td, #matrix td").all_inner_texts()
        return {text.strip() for text in shown} == {NOTHING} and self.tab.locator(".hypothesis").count() == 0


@pytest.fixture
def visit(browser, address):
    with browser.new_context(viewport={"width": 1280, "height": 900}) as context:
        yield Visit(context.new_page(), address)


@pytest.fixture(scope="module")
def estimators():
    return {name: ViewpointEstimator.from_pretrained(name, device="cpu") for name in build.MODELS}


def assert_close(visit, said, degrees):
    """The page says what the estimator says, in every part."""
    azimuth, elevation = visit.angles
    assert abs((azimuth - said.azimuth + 180) % 360 - 180) < degrees
    assert abs(elevation - said.elevation) < degrees
    assert visit.number("confidence") == pytest.approx(100 * said.confidence, abs=degrees)
    expected = [[each.azimuth, each.elevation, 100 * each.probability] for each in said.ranked()]
    assert np.allclose(visit.hypotheses, expected, atol=degrees + 0.06)  # they are shown with one digit


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """The same car as a PNG, turned by EXIF, with transparency, large, and of the networks' own size."""
    found = tmp_path_factory.mktemp("images")
    car = Image.open(CAR).convert("RGB")
    car.save(found / "plain.png")
    exif = Image.Exif()
    exif[274] = 6  # to be turned by 90 degrees
    car.transpose(Image.Transpose.ROTATE_90).save(found / "turned.jpg", exif=exif, quality=95)
    rows, columns = np.mgrid[: car.height, : car.width]
    x0, y0, x1, y1 = BOX
    # Opaque in an ellipse, with a soft edge; its colours go on where it is transparent.
    away = np.hypot((columns - (x0 + x1) / 2) / (x1 - x0), (rows - (y0 + y1) / 2) / (y1 - y0))
    alpha = Image.fromarray((255 * np.clip((0.6 - away) * 8, 0, 1)).astype(np.uint8))
    Image.merge("RGBA", (*car.split(), alpha)).save(found / "transparent.png")
    noise = np.random.default_rng(0).normal(0, 20, (3 * car.height, 3 * car.width, 3))
    large = np.asarray(car.resize((3 * car.width, 3 * car.height))) + noise
    Image.fromarray(large.clip(0, 255).astype(np.uint8)).save(found / "large.png")
    car.crop(BOX).resize((64, 64)).save(found / "ready.png")
    car.convert("L").save(found / "grey.png")
    car.quantize(16).save(found / "palette.png")
    return found


def test_page_command_line_python_and_onnx_give_one_answer(visit, folder, estimators, capsys):
    said = estimators["car"].predict(CAR, boxes=BOX)[0]
    options = ["--box", *map(str, BOX), "--model", "car", "--as", "matrix"]
    assert cli.main(["predict", str(CAR), "--json", *options]) == 0
    (printed,) = json.loads(capsys.readouterr().out)["images"]
    assert (printed["azimuth"], printed["elevation"]) == pytest.approx((said.azimuth, said.elevation), abs=EXACT)

    about = json.loads((folder / "models.json").read_text())["models"]["car"]
    session = onnxruntime.InferenceSession(folder / about["file"], providers=["CPUExecutionProvider"])
    framing = estimators["car"].framing
    prepared = prepare([crop_to_object(read_image(CAR, None, BOX), framing)], framing, torch.device("cpu"))
    vectors, logits = session.run(None, {"images": prepared.viewpoint[:, :3].numpy()})
    exported = vectors[0, logits[0].argmax()] @ np.array(about["rotation"]).T
    assert np.degrees(np.linalg.norm(exported - said.vector)) < EXACT

    visit.tab.locator("#example").click()
    visit.tab.locator(".hypothesis").first.wait_for()
    visit.settle()
    assert_close(visit, said, ALIKE)
    for frame in MEANINGS:
        assert np.allclose(visit.matrix(frame), said.rotation(frame), atol=np.radians(ALIKE))
    assert visit.problems == []
    assert all(url.startswith((visit.tab.url, "blob:")) for url in visit.requests)


CASES = [
    ("plain.png", None, EXACT),
    ("plain.png", BOX, EXACT),
    ("plain.png", (129.5, 108.25, 341.75, 200.5), EXACT),
    ("plain.png", (-50, 100, 200.3, 900), EXACT),
    ("transparent.png", None, EXACT),
    ("transparent.png", (140, 110, 300, 190), EXACT),
    ("large.png", None, EXACT),
    ("large.png", tuple(3 * edge + 0.4 for edge in BOX), EXACT),
    ("ready.png", None, EXACT),
    ("grey.png", BOX, EXACT),
    ("palette.png", BOX, EXACT),
    ("turned.jpg", None, ALIKE),
    ("turned.jpg", BOX, ALIKE),
]


@pytest.mark.parametrize(("file", "box", "degrees"), CASES)
def test_the_page_says_what_the_estimator_says(visit, images, estimators, file, box, degrees):
    visit.send(images / file)
    if box:
        visit.frame(box)
    for name, estimator in estimators.items():
        visit.choose(name)
        assert visit.message == ""
        assert_close(visit, estimator.predict(images / file, boxes=box)[0], degrees)
    assert visit.problems == []


SHAPES = [(256, 256, 0.0, False), (1000, 700, 0.2, True), (1531, 40, 0.0, False), (1800, 1100, 0.1, True)]


@pytest.mark.parametrize(("width", "height", "margin", "square"), SHAPES)
def test_images_are_cut_as_pillow_cuts_them(visit, width, height, margin, square):
    """Pixel by pixel, also with margins and squares that the built-in models do not have."""
    noise_cut = """([width, height, box, framing]) => import("./crop.js").then(({ cut }) => {
        const pixels = new Uint8ClampedArray(width * height * 4).fill(255);
        let state = 1;
        for (let i = 0; i < pixels.length; i++) {
            state = (state * 48271) % 2147483647;
            if (i % 4 < 3) pixels[i] = state >> 8;
        }
        return [cut({ width, height, pixels }, box, framing).pixels, pixels].map((each) => Array.from(each).join(" "));
    })"""
    box = (0.13 * width, 0.1 * height, 0.87 * width + 0.3, 0.9 * height)
    seen, drawn = visit.tab.evaluate(noise_cut, [width, height, box, {"size": 128, "margin": margin, "square": square}])
    pixels = np.array(drawn.split(), np.uint8).reshape(height, width, 4)[..., :3]
    expected = cut(Image.fromarray(pixels), box, Crop(128, margin, square))[..., :3]
    assert np.array_equal(np.array(seen.split(), np.uint8).reshape(128, 128, 3), expected)


def huge(path):
    """A PNG of 20000 x 20000 pixels in some kB."""

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", 20000, 20000, 1, 0, 0, 0, 0)
    content = zlib.compress(bytes(2501 * 20000), 9)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", content) + chunk(b"IEND", b""))


@pytest.mark.parametrize("kind", ["text", "cut off", "huge", "transparent"])
def test_a_bad_image_is_told_and_takes_the_answer_away(visit, images, tmp_path, kind):
    path = tmp_path / "photo.png"
    if kind == "text":
        path.write_text("no image")
    elif kind == "cut off":
        path.write_bytes((images / "plain.png").read_bytes()[:200])
    elif kind == "huge":
        huge(path)
    else:
        Image.new("RGBA", (80, 60)).save(path)
    visit.send(images / "plain.png")
    assert not visit.empty
    visit.send(path)
    expected = {
        "text": "photo.png is not an image that this browser can read, or it is damaged.",
        "cut off": "photo.png is not an image that this browser can read, or it is damaged.",
        "huge": "photo.png has more than 100 million pixels (20000 x 20000).",
        "transparent": "Everything there is transparent: there is no object to be seen.",
    }
    assert visit.message == expected[kind]
    assert visit.empty
    visit.send(images / "plain.png")
    assert visit.message == ""
    assert not visit.empty


@pytest.mark.parametrize(
    ("box", "message"),
    [
        ((0, 0, 0, 0), "The box has no area: left has to be below right, and top below bottom."),
        ((30, 0, 20, 10), "The box has no area: left has to be below right, and top below bottom."),
        ((9000, 0, 9100, 50), "The box has no part in the image ({} x {} pixels)."),
        ((10, 10, "", 50), "The box needs four numbers, in pixels: left, top, right and bottom."),
    ],
)
def test_a_bad_box_is_told_and_takes_the_answer_away(visit, images, box, message):
    visit.send(images / "plain.png")
    assert not visit.empty
    visit.frame(box)
    assert visit.message == message.format(*Image.open(CAR).size)
    assert visit.empty
    visit.tab.locator("#whole").click()
    visit.settle()
    assert visit.message == ""
    assert not visit.empty


def test_a_box_is_drawn_and_a_click_is_no_box(visit, images):
    visit.send(images / "plain.png")
    place = visit.tab.locator("#canvas").bounding_box()
    x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
    visit.tab.mouse.move(x - 60, y - 40)
    visit.tab.mouse.down()
    visit.tab.mouse.move(x + 60, y + 40, steps=3)
    visit.tab.mouse.up()
    visit.settle()
    drawn = [float(visit.tab.locator(f"#box [name={name}]").input_value()) for name in ("x0", "y0", "x1", "y1")]
    assert (drawn[2] - drawn[0]) / (drawn[3] - drawn[1]) == pytest.approx(1.5, abs=0.05)
    assert not visit.empty
    visit.tab.mouse.click(x, y)
    visit.settle()
    assert visit.message.startswith("The box has no area")
    assert visit.empty


def test_what_is_asked_last_is_answered(visit, images, estimators):
    visit.tab.locator("#file").set_input_files(images / "large.png")
    visit.tab.locator("#file").set_input_files(images / "grey.png")
    visit.choose("chair")  # while images are being read
    visit.tab.locator(".hypothesis").first.wait_for()
    assert_close(visit, estimators["chair"].predict(images / "grey.png")[0], EXACT)
    assert visit.problems == []


def test_it_answers_by_keyboard_alone(visit):
    visit.tab.locator("#model").focus()
    reached = []
    for _ in range(2):
        visit.tab.keyboard.press("Tab")
        reached.append(visit.tab.evaluate("document.activeElement.id"))
    assert reached == ["file", "example"]
    visit.tab.keyboard.press("Enter")
    visit.tab.locator(".hypothesis").first.wait_for()
    assert not visit.empty


def test_nothing_moves_when_an_answer_comes(visit, images):
    parts = "#stage, #box, #message, #words, #numbers, #compass, #hypotheses, #rotation, footer"
    before = [each.bounding_box() for each in visit.tab.locator(parts).all()]
    visit.send(images / "plain.png")
    visit.frame(BOX)
    assert [each.bounding_box() for each in visit.tab.locator(parts).all()] == before


@pytest.mark.parametrize("width", [320, 390, 1280])
def test_nothing_is_cut_off(browser, address, images, width):
    with browser.new_context(viewport={"width": width, "height": 844}) as context:
        visit = Visit(context.new_page(), address)
        visit.send(images / "plain.png")
        assert visit.tab.evaluate("document.documentElement.scrollWidth") <= width
        cut = """() => [...document.querySelectorAll("#compass svg")].flatMap((svg) => {
            const frame = svg.getBoundingClientRect();
            return [...svg.querySelectorAll("*")].map((each) => each.getBoundingClientRect()).filter((box) =>
                box.left < frame.left || box.right > frame.right || box.top < frame.top || box.bottom > frame.bottom);
        }).length"""
        assert visit.tab.evaluate(cut) == 0


def test_the_page_is_small_and_answers_soon(browser, address, folder, images):
    assert sum(path.stat().st_size for path in folder.iterdir()) <= 15_000_000
    with browser.new_context() as context:
        visit = Visit(context.new_page(), address)
        begun = time.perf_counter()
        visit.send(images / "plain.png")
        assert not visit.empty
        assert time.perf_counter() - begun < 2


def test_the_page_may_load_only_its_own_files(visit, folder):
    asked = """() => Promise.all(["https://example.org/", "data:text/plain,"].map(
        (address) => fetch(address).then(() => "sent", () => "refused")))"""
    assert visit.tab.evaluate(asked) == ["refused", "refused"]
    refused = [text for text in visit.problems if "Content Security Policy" in text]
    assert len(refused) >= 2
    for path in folder.glob("*.js"):
        assert "http" not in path.read_text().replace("http://www.w3.org/2000/svg", "").replace("http.server", "")


def test_models_and_example_are_those_of_package_and_documents():
    offered = re.findall(r'<option value="(\w+)"', (ROOT / "web" / "index.html").read_text().partition("</select>")[0])
    assert offered == list(build.MODELS)
    assert sorted(offered) == shipped()
    assert script("example").BOX == BOX


def test_what_is_no_page_is_not_emptied(tmp_path):
    (tmp_path / "kept").touch()
    with pytest.raises(SystemExit, match="holds something else"):
        build.build(tmp_path)
    assert (tmp_path / "kept").is_file()


def test_what_a_failure_leaves_is_emptied_the_next_time(tmp_path, monkeypatch):
    for name in (build.RUNTIME, build.WASM):
        (tmp_path / name).touch()
    monkeypatch.setattr(build, "installed", lambda *where: tmp_path)
    monkeypatch.setattr(build, "MODELS", ("car", "nowhere"))
    for _ in range(2):
        with pytest.raises(ViewnetError, match="nowhere: no model there"):
            build.build(tmp_path / "page")


def test_without_npm_one_sentence_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SystemExit, match=r"^web: there is no npm here: install Node\.js"):
        build.main([str(tmp_path / "page")])
    assert not (tmp_path / "page").exists()
