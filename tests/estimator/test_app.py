"""The page: its event handlers, and all of it in a browser, if there is one (Debian: apt-get install chromium)."""

from __future__ import annotations

import io
import json
import socket
import urllib.request
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from helpers.boxes import box_store
from helpers.browser import Visitor, chromium
from helpers.estimators import PHOTOS, photograph, untrained
from helpers.ports import free_port
from helpers.untrained_models import finished_run
from PIL import Image
from safetensors.torch import save_file

from viewnet import cli
from viewnet.commands import demo
from viewnet.estimator import ViewpointEstimator
from viewnet.estimator.demo import analysis, examples
from viewnet.model.checkpoint import load_model
from viewnet.recipes import make_config

gradio = pytest.importorskip("gradio", reason='the page needs gradio: pip install "viewnet[demo]"')

from viewnet.estimator.demo import app  # noqa: E402  (it imports gradio)

BOX = (10, 8, 70, 50)
TYPED = "10 8 70 50"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Of a finished run, and of what visitors send: gradio's own folder of uploads."""
    found = tmp_path_factory.mktemp("page")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GRADIO_TEMP_DIR", str(found))
        yield filled(found)


def filled(found):
    store = box_store(found / "views", {"val": 3, "test": 3}, views=3)
    finished_run(found / "run", store, **PHOTOS)
    look_closely(found / "run")
    for number in range(2):
        Image.fromarray(photograph(seed=number)).save(found / f"photo{number}.png")
    mask = np.zeros((60, 90), np.uint8)
    Image.fromarray(mask).save(found / "empty.png")
    mask[10:50, 20:80] = 255
    Image.fromarray(mask).save(found / "mask.png")
    (found / "notes.txt").write_text("no image")
    (found / "notes.png").write_text("no image either")
    return found


def look_closely(run):
    """Make an untrained network's predictions differ between photographs, by fitting its batch statistics to them."""
    network, config = load_model(run)
    size = config.model.input_size
    photos = torch.from_numpy(np.stack([photograph(size, size, seed) for seed in range(16)])).movedim(-1, 1) / 255
    network.train()
    with torch.no_grad():
        for _ in range(40):
            network.viewpoint(photos)
    weights = {name: value.contiguous() for name, value in network.state_dict().items()}
    save_file(weights, run / "checkpoint.safetensors", metadata={"config": json.dumps(config.to_dict())})


@pytest.fixture(scope="module")
def estimator(folder):
    return ViewpointEstimator.from_pretrained(folder / "run")


@pytest.fixture(scope="module")
def page(estimator):
    return app.Page(estimator, examples.rendered(estimator)[:1])


def sent(file, name=None):
    """A file as the browser uploads it."""
    return {"path": str(file), "orig_name": name or file.name, "meta": {"_type": "gradio.FileData"}}


def taken(page, file):
    """What has been chosen after an image was sent."""
    return list(page.take(sent(file)))[-1][0]


def test_asked_about_a_box_the_page_says_what_the_estimator_says(page, estimator, folder):
    file = folder / "photo0.png"
    shown = page.predict(taken(page, file), None, TYPED)
    said = estimator.predict(file, boxes=BOX)[0]
    encoded, told, _, posed, table, azimuth, elevation, view, mesh, sides = shown
    for part in (f">{said.azimuth:.1f}°<", f">{said.elevation:.1f}°<", f">{100 * said.confidence:.1f} %<"):
        assert part in told
    assert table.count("<tr>") == 1 + len(said.probabilities)
    assert np.array_equal(posed, estimator.reconstruct(file, boxes=BOX, size=len(posed))[0])
    assert (azimuth, elevation) == (round(said.azimuth) % 360, round(said.elevation))
    assert np.array_equal(view, page.turn(encoded, azimuth, elevation))
    assert not np.array_equal(view, page.turn(encoded, azimuth + 90, elevation))
    drawn = trimesh.load(mesh["value"], force="mesh")
    assert len(drawn.faces) == len(estimator.mesh(file, box=BOX).faces)
    turned, tilted, away = mesh["camera_position"]
    assert (turned % 360, tilted) == (-azimuth % 360, 90 - elevation)
    assert away > 3 * np.linalg.norm(drawn.vertices, axis=1).max()
    assert (mesh["visible"], sides["visible"], sides["value"]) == (True, False, None)


def test_where_a_browser_cannot_turn_the_model_it_is_drawn_here(page, estimator, folder):
    file = folder / "photo0.png"
    *_, azimuth, elevation, _, mesh, sides = page.predict(taken(page, file), None, TYPED, True)
    assert (mesh["visible"], mesh["value"], sides["visible"]) == (False, None, True)
    expected = analysis.four_sides(estimator.mesh(file, box=BOX), azimuth, elevation)
    assert np.array_equal(sides["value"], expected)
    assert len(np.unique(expected.reshape(-1, 3), axis=0)) > 20


def test_a_mask_counts_and_so_does_what_is_missing(page, estimator, folder):
    file, mask = folder / "photo0.png", folder / "mask.png"
    chosen = taken(page, file)
    masked = page.predict(chosen, sent(mask), "")[1]
    assert f">{estimator.predict(file, mask)[0].azimuth:.1f}°<" in masked
    assert "whole image" not in masked
    assert "whole image" in page.predict(chosen, None, "")[1]


@pytest.mark.parametrize(
    ("mask", "box", "message"),
    [
        (None, "100 0 120 30", "box has no part in the image"),
        (None, "30 0 20 30", "x0 below x1"),
        (None, "30 0 20", "expected its left, top"),
        (None, "all", "expected its left, top"),
        ("empty.png", "", "mask is empty"),
        ("notes.txt", "", "mask notes.txt does not decode"),
    ],
)
def test_what_is_wrong_is_told_in_a_toast(page, folder, mask, box, message):
    file = None if mask is None else sent(folder / mask)
    with pytest.raises(gradio.Error) as caught:
        page.predict(taken(page, folder / "photo0.png"), file, box)
    assert message in caught.value.message
    assert not caught.value.print_exception


def test_names_of_files_are_no_markup(page, folder):
    with pytest.raises(gradio.Error) as caught:
        list(page.take(sent(folder / "notes.txt", "<img src=x>.png")))
    assert "&lt;img" in caught.value.message
    assert "<img" not in caught.value.message


@pytest.mark.parametrize("marked", [True, False])
def test_a_path_that_is_no_upload_is_not_read(page, tmp_path, marked):
    """Gradio itself checks only what is marked as a file."""
    Image.fromarray(photograph()).save(tmp_path / "secret.png")
    forged = sent(tmp_path / "secret.png")
    if not marked:
        del forged["meta"]
    with pytest.raises(gradio.Error, match="load the page again"):
        list(page.take(forged))


def test_another_image_takes_the_answer_away(page, folder):
    for file in (sent(folder / "photo1.png"), None):
        last = list(page.take(file))[-1]
        assert last[2:5] == ["", None, app.WAITING]
    events = page.take(sent(folder / "notes.png"))
    last = next(events)
    assert last[0] is None
    assert last[1] is None
    with pytest.raises(gradio.Error, match="does not decode"):
        next(events)


def test_without_a_mesh_all_else_is_shown(page, estimator, folder):
    network = untrained(variant="hologan_decoder", **PHOTOS)
    shown = app.Page(network, []).predict(taken(page, folder / "photo0.png"), None, TYPED)
    assert shown[-2]["value"] is shown[-1]["value"] is None
    assert "There is no 3-D model: volume: the HoloGAN decoder" in shown[1]
    assert shown[3].ndim == 3


def test_a_model_without_alignment_is_reported(folder, page):
    own = ViewpointEstimator(untrained(**PHOTOS).network, replace(make_config(profile="smoke"), recipe="photos"))
    told = app.Page(own, []).predict(taken(page, folder / "photo0.png"), None, TYPED)[1]
    assert "azimuth 0 and up are arbitrary" in told
    assert "it shows" not in told


@pytest.fixture(scope="module")
def reached():
    """Addresses outside of this machine that the server contacted."""
    found, connect = [], socket.socket.connect

    def noted(self, address):
        if self.family in (socket.AF_INET, socket.AF_INET6) and address[0] not in ("127.0.0.1", "::1", "localhost"):
            found.append(address)
        return connect(self, address)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "connect", noted)
        yield found


@pytest.fixture(scope="module")
def address(folder, reached):
    """Of the page that `viewnet demo` serves."""
    options = cli.parser().parse_args(["demo", "--model", str(folder / "run"), "--port", str(free_port())])
    served = demo.start(options)
    yield served.local_url
    served.close()


FORGED = [{"path": "/etc/passwd", "meta": {"_type": "gradio.FileData"}}, {"path": "/etc/passwd"}, {"path": 5}, "text"]


@pytest.mark.parametrize("forged", FORGED, ids=str)
def test_what_the_page_does_not_send_is_refused_without_a_traceback(forged, address, capfd):
    layout = json.load(urllib.request.urlopen(f"{address}config"))
    taking = next(event["id"] for event in layout["dependencies"] if event["api_name"] == "take")
    asked = {"data": [forged], "fn_index": taking, "session_hash": "visitor"}
    body, kind = json.dumps(asked).encode(), {"Content-Type": "application/json"}
    join = urllib.request.Request(f"{address}gradio_api/queue/join", body, kind)
    urllib.request.urlopen(join).close()
    with urllib.request.urlopen(f"{address}gradio_api/queue/data?session_hash=visitor", timeout=60) as lines:
        done = next(json.loads(line[5:]) for line in lines if b"process_completed" in line)
    assert done["output"]["error"] == app.SENT
    assert "Traceback" not in "".join(capfd.readouterr())


@pytest.fixture(scope="module")
def browser():
    with chromium("--use-angle=swiftshader", "--enable-unsafe-swiftshader") as found:  # 3-D without a GPU
        yield found


class Visit(Visitor):
    READY = "#find"

    def noted(self, line):
        # The 3-D viewer complains where a browser offers WebGPU on a machine that has none, and takes WebGL.
        if "WebGPU" not in line.text:
            super().noted(line)

    def send(self, file):
        """An image, and wait until the server has taken it and shows it in its own format."""
        self.tab.locator("#image input[type=file]").set_input_files(file)
        self.tab.locator("#image img[src$='.webp']").wait_for()

    def send_mask(self, file):
        self.tab.locator("#mask input[type=file]").set_input_files(file)
        self.tab.locator(f"#mask img[src$='{file.name}']").wait_for()

    @property
    def box(self):
        return self.tab.locator("#box textarea, #box input")

    def frame(self, box):
        self.box.fill(" ".join(map(str, box)))

    def find(self):
        """Request a prediction and wait for it: azimuth, elevation and confidence."""
        self.tab.locator("#find").click()
        return self.answer()

    def answer(self):
        self.tab.locator("#hypotheses table").wait_for()
        return self.tab.locator("#answer b").all_inner_texts()

    def image(self, where):
        """Pixels (H, W, 3) of an image on the page, as the server has it."""
        source = self.tab.locator(f"{where} img").get_attribute("src")
        with Image.open(io.BytesIO(self.tab.request.get(source).body())) as file:
            return np.asarray(file.convert("RGB"))

    def toast(self):
        """The error message shown; closes it."""
        told = self.tab.locator(".toast-body.error")
        told.wait_for()
        text = told.inner_text()
        self.tab.locator(".toast-close").first.click()
        told.wait_for(state="detached")
        return text


@contextmanager
def visiting(browser, address, **settings):
    with browser.new_context(viewport={"width": 1200, "height": 900}, **settings) as context:
        yield Visit(context.new_page(), address)


@pytest.fixture
def visit(browser, address):
    with visiting(browser, address) as found:
        yield found


def spoken(said):
    rival = said.rival
    azimuths = [f"{each.azimuth:.1f}°" for each in (said, rival) if each]
    return [*azimuths, f"{said.elevation:.1f}°", f"{100 * said.confidence:.1f} %"]


def settled(look, before, tab):
    """What `look` finds once it differs from what was there before."""
    for _ in range(600):
        if not np.array_equal(now := look(), before):
            return now
        tab.wait_for_timeout(100)
    raise AssertionError("nothing changed on the page")


@pytest.mark.slow
def test_prediction_from_upload_to_answer(visit, estimator, folder, address, reached):
    visit.send(folder / "photo0.png")
    visit.frame(BOX)
    said = estimator.predict(folder / "photo0.png", boxes=BOX)[0]
    assert visit.find() == spoken(said)
    dials = visit.tab.locator("#answer svg")
    assert dials.count() == 2
    assert f"azimuth {said.azimuth:.0f} degrees" in dials.first.get_attribute("aria-label")
    rows = visit.tab.locator("#hypotheses tbody tr").all_inner_texts()
    shares = sorted(said.probabilities, reverse=True)
    assert [f"{100 * share:.1f} %" in row for row, share in zip(rows, shares, strict=True)] == [True] * len(shares)
    drawn = dials.first.screenshot()
    visit.frame((0, 20, 45, 60))
    visit.tab.locator("#find").click()
    again = estimator.predict(folder / "photo0.png", boxes=(0, 20, 45, 60))[0]
    assert settled(visit.answer, spoken(said), visit.tab) == spoken(again)
    assert dials.first.screenshot() != drawn
    assert visit.problems == []
    assert [url for url in visit.requests if not url.startswith((address, "blob:", "data:"))] == []
    assert len(visit.requests) > 10
    assert reached == []


@pytest.mark.slow
def test_the_object_turns_as_the_slider_moves(visit, estimator, folder):
    visit.send(folder / "photo0.png")
    visit.frame(BOX)
    visit.find()
    before = visit.image("#view")
    slider = visit.tab.locator("#azimuth input[type=range]")
    start = float(slider.input_value())
    slider.focus()
    for _ in range(30):
        slider.press("ArrowRight" if start < 300 else "ArrowLeft")
    azimuth = start + 30 if start < 300 else start - 30
    assert float(slider.input_value()) == azimuth
    elevation = float(visit.tab.locator("#elevation input[type=range]").input_value())
    expected = estimator.novel_view(folder / "photo0.png", azimuth, elevation, boxes=BOX, size=len(before))[0]
    settled(lambda: np.abs(visit.image("#view").astype(int) - expected).max() <= 1, False, visit.tab)
    assert not np.array_equal(visit.image("#view"), before)
    assert visit.problems == []


@pytest.mark.slow
def test_two_clicks_draw_the_box(visit, folder):
    visit.send(folder / "photo0.png")
    before = visit.image("#image")
    image = visit.tab.locator("#image img")
    place = image.bounding_box()
    scale = min(place["width"] / 90, place["height"] / 60)
    left = (place["width"] - 90 * scale) / 2
    top = (place["height"] - 60 * scale) / 2
    for x, y in ((70, 50), (10, 8)):
        image.click(position={"x": left + x * scale, "y": top + y * scale})
        before = settled(lambda: visit.image("#image"), before, visit.tab)
    assert np.allclose([float(word) for word in visit.box.input_value().split()], BOX, atol=1.5)
    visit.tab.locator("#unbox").click()
    settled(visit.box.input_value, visit.box.input_value(), visit.tab)
    assert visit.box.input_value() == ""


@pytest.mark.slow
def test_what_is_wrong_is_toasted_and_nothing_breaks(visit, estimator, folder):
    visit.tab.locator("#find").click()
    assert "no image" in visit.toast()
    visit.tab.locator("#image input[type=file]").set_input_files(folder / "notes.png")
    assert "image notes.png does not decode" in visit.toast()
    visit.send(folder / "photo0.png")
    visit.frame((100, 0, 120, 30))
    visit.tab.locator("#find").click()
    assert "box has no part in the image (90 x 60)" in visit.toast()
    visit.tab.locator("#unbox").click()
    visit.tab.locator("#mask-panel button").first.click()
    visit.send_mask(folder / "empty.png")
    visit.tab.locator("#find").click()
    told = visit.toast()
    assert "mask is empty" in told
    assert "Traceback" not in told
    visit.tab.locator("#mask button[aria-label='Remove Image']").click()
    visit.send_mask(folder / "mask.png")
    assert visit.find() == spoken(estimator.predict(folder / "photo0.png", folder / "mask.png")[0])
    # An error takes the answer before it away.
    visit.box.fill("10 8")
    visit.tab.locator("#find").click()
    assert "expected its left, top" in visit.toast()
    visit.tab.locator("#hypotheses table").wait_for(state="detached")
    assert "Choose an image" in visit.tab.locator("#answer").inner_text()
    assert visit.tab.locator(":is(#seen, #posed, #view, #sides) img").count() == 0


@pytest.mark.slow
def test_a_file_that_is_too_large_is_refused(visit, tmp_path):
    (tmp_path / "large.png").write_bytes(bytes(21 * 2**20))
    visit.tab.locator("#image input[type=file]").set_input_files(tmp_path / "large.png")
    assert "size" in visit.toast()


@pytest.mark.slow
def test_without_a_graphics_card_the_3d_model_is_a_picture(visit, folder):
    visit.send(folder / "photo0.png")
    visit.frame(BOX)
    visit.find()
    visit.tab.locator("#sides img").wait_for()
    assert len(np.unique(visit.image("#sides").reshape(-1, 3), axis=0)) > 20
    assert visit.tab.locator("#mesh canvas").count() == 0
    assert visit.problems == []


CARD = """
    const real = WebGL2RenderingContext.prototype.getParameter;
    WebGL2RenderingContext.prototype.getParameter = function (name) {
        return name === 0x9246 ? "a graphics card" : real.call(this, name);
    };
"""


@pytest.fixture
def with_card(browser, address):
    """A visit that says to have a graphics card."""
    with browser.new_context(viewport={"width": 1200, "height": 900}) as context:
        context.add_init_script(CARD)
        yield Visit(context.new_page(), address)


@pytest.mark.slow
def test_the_3d_model_is_the_objects(with_card, estimator, folder):
    visit = with_card
    visit.send(folder / "photo0.png")
    visit.frame(BOX)
    with visit.tab.expect_response(lambda response: response.url.endswith(".glb")) as coming:
        visit.find()
    body = visit.tab.request.get(coming.value.url).body()
    drawn = trimesh.load(io.BytesIO(body), file_type="glb", force="mesh")
    assert len(drawn.faces) == len(estimator.mesh(folder / "photo0.png", box=BOX).faces)
    canvas = visit.tab.locator("#mesh canvas")
    settled(lambda: len(np.unique(pixels(canvas).reshape(-1, 3), axis=0)) > 20, False, visit.tab)
    before = pixels(canvas)
    place = canvas.bounding_box()
    visit.tab.mouse.move(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
    visit.tab.mouse.down()
    visit.tab.mouse.move(place["x"] + place["width"] / 2 + 90, place["y"] + place["height"] / 2, steps=5)
    visit.tab.mouse.up()
    settled(lambda: pixels(canvas), before, visit.tab)
    assert visit.problems == []


def pixels(element):
    with Image.open(io.BytesIO(element.screenshot())) as image:
        return np.asarray(image.convert("RGB"))


@pytest.mark.slow
def test_examples_answer_at_one_click(visit, estimator):
    visit.tab.locator("#examples button").first.click()
    example = examples.rendered(estimator)[0]
    assert visit.answer() == spoken(estimator.predict(example.image, boxes=example.box)[0])
    assert [float(word) for word in visit.box.input_value().split()] == list(example.box)


@pytest.mark.slow
def test_visitors_do_not_see_each_others_images(browser, address, estimator, folder):
    with visiting(browser, address) as one, visiting(browser, address) as other:
        one.send(folder / "photo0.png")
        other.send(folder / "photo1.png")
        for visitor in (one, other):
            visitor.frame(BOX)
        # Both at once.
        for visitor in (one, other):
            visitor.tab.locator("#find").click()
        for number, visitor in enumerate((one, other)):
            said = estimator.predict(folder / f"photo{number}.png", boxes=BOX)[0]
            assert visitor.answer() == spoken(said)
        before = one.image("#view")
        one.tab.locator("#elevation input[type=range]").press("ArrowUp")
        settled(lambda: one.image("#view"), before, one.tab)
        assert one.answer() != other.answer()
        with visiting(browser, address) as third:
            third.tab.locator("#find").click()
            assert "no image" in third.toast()


@pytest.mark.slow
def test_everything_is_reached_by_the_keyboard_and_has_a_name(visit):
    wanted = {"box", "image", "find", "unbox", "azimuth", "elevation", "examples"}
    reached, unnamed = set(), []
    for _ in range(60):
        visit.tab.keyboard.press("Tab")
        place, name = visit.tab.evaluate(
            """() => {
                const one = document.activeElement;
                const label = one.closest("label") || (one.labels && one.labels[0]);
                const said = one.getAttribute("aria-label") || one.innerText || (label && label.innerText);
                let ids = []; for (let e = one; e; e = e.parentElement) if (e.id) ids.push(e.id);
                return [ids, said || ""];
            }"""
        )
        reached.update(place)
        if not name.strip():
            unnamed.append(place)
    assert wanted <= reached
    assert unnamed == []


@pytest.mark.slow
def test_on_a_telephone_nothing_is_wider_than_the_screen(browser, address, folder):
    with browser.new_context(viewport={"width": 390, "height": 844}) as context:
        visit = Visit(context.new_page(), address)
        visit.send(folder / "photo0.png")
        visit.frame(BOX)
        visit.find()
        assert visit.tab.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_labels_and_edges_cover_nothing(browser, address, width):
    with browser.new_context(viewport={"width": width, "height": 900}) as context:
        visit = Visit(context.new_page(), address)
        visit.tab.locator("#examples button").first.click()
        visit.answer()
        visit.tab.locator("#sides").scroll_into_view_if_needed()  # where images load
        visit.tab.locator("#sides img").wait_for()
        for name in ("image", "seen", "posed", "view", "sides"):
            label, image = (visit.tab.locator(f"#{name} {part}").first.bounding_box() for part in ("label", "img"))
            assert label["y"] + label["height"] <= image["y"] + 1, name
        assert visit.tab.locator("#examples label.float").count() == 0
        cut = """svg => { const [x, y, w, h] = svg.getAttribute("viewBox").split(" ").map(Number);
            return [...svg.querySelectorAll("text")].map(text => [text.textContent, text.getBBox()])
                .filter(([, box]) => box.x < x || box.y < y || box.x + box.width > x + w || box.y + box.height > y + h)
                .map(([name]) => name); }"""
        dials = visit.tab.locator("#answer svg")
        assert [dials.nth(number).evaluate(cut) for number in range(2)] == [[], []]
