"""The overview page: it shows every file of the folder unchanged, and is self-contained."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from PIL import Image

from viewnet import cli
from viewnet.errors import ViewnetError
from viewnet.experiments.page import images, page
from viewnet.runtime.files import write_json
from viewnet.tables import claims
from viewnet.tables.columns import METRICS

COMMITTED = Path(__file__).resolve().parents[2] / "paper_tables"
VOID = {"meta", "img", "source", "br", "hr"}


class Page(HTMLParser):
    """A page's elements and text; asserts that every element is closed where it should be."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, f"line {self.getpos()[0]}"

    def handle_data(self, data):
        self.text += data if "style" not in self.open else ""

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


def cell(row: str, category: str, measured: float | None, printed: str = "", **more: object) -> dict[str, object]:
    result = {"row": row, "variant": "viewnet", "category": category, "metric": "acc30", "printed": printed}
    result |= {"bold": False, "measured": measured, "sd": None, "low": None, "high": None, "seeds": 1, "images": 50}
    return result | {"objects": 10, "runs": ["0123456789ab"]} | more


def table(folder: Path, name: str = "table2_ablation", **more: object) -> None:
    """A table's JSON, with a row and a run that only escaping makes harmless."""
    evil = "<script>alert('a & b')</script>"
    cells = [
        cell("ViewNet", "car", 89.7, "89", bold=True, low=86.8, high=92.5),
        cell(evil, "car", 50.04),
        cell("MVC", "car", None, "87", seeds=0, runs=[]),
    ]
    training = {"finished": "2026-01-02T03:04:05+00:00", "seconds": 120.0, "git": {"commit": "c" * 40, "dirty": False}}
    run = {"variant": "viewnet", "category": "car", "profile": "tiny", "recipe": evil, "seed": 0, "training": training}
    listed = {
        "table": name,
        "title": "Ablation study",
        "measured on": "made-up models",
        "error": "angle",
        "interval": "95 %",
    }
    write_json(folder / f"{name}.json", listed | {"cells": cells, "runs": {"0123456789ab": run}} | more)


def write_image(path: Path, frames: int = 1, width: int = 40) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    rendered = [Image.fromarray(np.full((20, width, 3), 40 * n + 9, np.uint8)) for n in range(frames)]
    rendered[0].save(path, **({"save_all": True, "append_images": rendered[1:]} if frames > 1 else {}))


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("VIEWNET_TABLES", str(tmp_path / "tables"))
    table(tmp_path / "tables")
    return tmp_path / "tables"


def written(folder: Path) -> Page:
    return Page(page.write(folder).read_text(encoding="utf-8"))


def test_printed_and_measured_numbers_stand_with_intervals_and_runs(folder):
    page = written(folder)
    assert "89.7 [86.8, 92.5]" in page.text
    about = [td["title"] for td in page.all("td") if "title" in td]
    assert about[0] == "89.7: 50 images of 10 objects, 1 seed; runs: 0123456789ab"
    text = (folder / "index.html").read_text()
    assert '<td class="print"><b>89</b></td>' in text
    assert '<span class="best">89.7</span>' in text and '<span class="best">50.0</span>' not in text
    assert "1 run · profile tiny" in page.text
    assert "trained 2026-01-02" in page.text and "commit ccccccc" in page.text and "made-up models" in page.text


def test_a_degenerate_number_stands_in_brackets_and_is_no_best(folder):
    table(folder, cells=[cell("ViewNet", "car", 50.0, degenerate=1), cell("Single-head", "car", 40.0)])
    text = (page.write(folder)).read_text(encoding="utf-8")
    assert "<span>(50.0)</span>" in text and 'class="best"' not in text.split("</style>")[1].split("<table")[1]


def test_what_files_say_is_text_and_never_markup(folder):
    (folder / "trust").mkdir()
    (folder / "trust" / "fuzz.csv").write_text("reader,<b>cases</b>\n<script>alert(1)</script>,3\n")
    page = written(folder)
    assert not page.all("script")
    assert "<script>alert('a & b')</script>" in page.text and "<script>alert(1)</script>" in page.text
    assert "<b>cases</b>" in page.text


def test_it_needs_nothing_but_itself(folder):
    write_image(folder / "figure3_azimuth.png")
    (folder / "figure3_azimuth.pdf").write_bytes(b"%PDF")
    write_image(folder / "figures" / "turntable_car.gif", frames=3)
    page = written(folder)
    images = page.all("img")
    assert len(images) == 2
    for image in images:
        assert image["src"].startswith("data:image/webp;base64,") and len(image["alt"]) > 30
    moving = next(image for image in images if "car" in image["alt"])
    still = page.all("source")[0]
    assert "prefers-reduced-motion" in still["media"] and still["srcset"] != moving["src"]
    assert not {tag for tag, _ in page.elements} & {"script", "link", "iframe", "object", "embed"}
    for _, attributes in page.elements:
        for name in ("src", "srcset", "href"):
            value = attributes.get(name) or ""
            assert not re.match(r"(?i)(https?:|//|javascript:)", value)
    assert "url(" not in (folder / "index.html").read_text() and "@import" not in (folder / "index.html").read_text()


def test_links_lead_somewhere_and_ids_are_there_once(folder):
    shutil.copytree(folder, folder.parent / "copy")
    shutil.move(folder.parent / "copy", folder / "tiny car & more")
    write_image(folder / "tiny car & more" / "figure3_azimuth.png")
    page = written(folder)
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    hrefs = [a["href"] for a in page.all("a")]
    for href in hrefs:
        if href.startswith("#"):
            assert href[1:] in ids
        elif href != "published/":
            assert (folder / unquote(href)).is_file(), href
    assert {"#table2_ablation", "#missing"} <= set(hrefs)
    assert "table2_ablation.json" in hrefs


def test_claims_come_first_with_their_verdict_and_lead_to_their_evidence(folder):
    places = ("table2_ablation.json", "tiny/car/table2_ablation.json")
    shutil.copytree(folder, folder.parent / "copy")
    shutil.move(folder.parent / "copy", folder / "tiny" / "car")
    rules = "".join(f"[[claim.rules]]\nfile = '{place}'\ncannot = 'no <i>'\n" for place in places)
    about = {"id": "a", "says": "More is <b>better</b>.", "place": "Table 2", "criterion": "It is.", "scope": "toy"}
    entry = "".join(f"{name} = '{text}'\n" for name, text in about.items())
    (folder / claims.NAME).write_text(f"[[claim]]\n{entry}{rules}")
    page = written(folder)
    assert "1 claim: 1 cannot be tested here" in page.text and "More is <b>better</b>." in page.text
    assert page.text.index("Claims of the paper") < page.text.index("is the number in the paper")
    hrefs, ids = ([attributes.get(name) for _, attributes in page.elements] for name in ("href", "id"))
    for anchor in ("table2_ablation", "table2_ablation-tiny-car"):
        assert f"#{anchor}" in hrefs and anchor in ids
    assert claims.NAME in hrefs
    (folder / claims.NAME).unlink()
    assert "Claims of the paper" not in written(folder).text


def test_reported_numbers_have_their_notes(folder):
    assert "reported for Constant: no constant scores so" in written(folder).text


def test_what_stands_below_the_claims_is_folded_and_named_in_words(folder):
    shutil.copytree(folder, folder.parent / "copy")
    shutil.move(folder.parent / "copy", folder / "real_cars")
    shutil.copytree(folder / "real_cars", folder / "tiny-own_set")
    page = written(folder)
    folded = [about for about in page.all("details") if about.get("class") in ("part", "setting")]
    assert len(folded) == 3 and not any("open" in about for about in folded)
    assert "Photographs of Stanford Cars" in page.text and "tiny own set" in page.text
    headings = re.findall(r"<h[23]>.*?</h[23]>", (folder / "index.html").read_text(encoding="utf-8"))
    assert not any("real_cars" in heading or "own_set" in heading for heading in headings)


@pytest.mark.parametrize("dirty", [False, True])
def test_runs_of_code_that_was_not_committed_are_told(folder, dirty):
    path = folder / "table2_ablation.json"
    content = json.loads(path.read_text())
    content["runs"]["0123456789ab"]["training"]["git"]["dirty"] = dirty
    path.write_text(json.dumps(content))
    assert ("1 of 1 runs are of code with changes that were not committed" in written(folder).text) == dirty


def test_what_is_not_there_is_named_with_its_command(folder):
    text = written(folder).text
    assert "Not made yet" in text and "viewnet notebook table4_freiburg" in text
    assert "viewnet notebook your_method" in text


def test_the_same_files_make_the_same_page(folder):
    write_image(folder / "figures" / "volumes_car.png")
    first = page.write(folder).read_bytes()
    assert page.write(folder).read_bytes() == first


def test_a_wide_figure_is_shrunk(folder, monkeypatch):
    rng = np.random.default_rng(0)
    noise = Image.fromarray(rng.integers(0, 256, (300, 600, 3), dtype=np.uint8))
    noise.save(folder / "figure3_azimuth.png")
    whole = page.write(folder).stat().st_size
    monkeypatch.setattr(images, "WIDEST", 150)
    assert page.write(folder).stat().st_size < whole / 4


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("table1_shapenet.json", "{", "table1_shapenet.json: not JSON"),
        ("table1_shapenet.json", '{"table": "table1_shapenet"}', "table1_shapenet.json: not as this"),
        ("alignment_study_scores.csv", "a,b\n1,2\n", "alignment_study_scores.csv: not as"),
        ("architecture_encoder.csv", "a\n1\n", "architecture_encoder.csv: columns"),
        ("figure3_azimuth.png", "no image", "figure3_azimuth.png: image does not"),
    ],
)
def test_damaged_files_are_named_and_the_page_stays(folder, name, content, message, capsys):
    before = page.write(folder).read_bytes()
    (folder / name).write_text(content)
    assert cli.main(["tables", "--page"]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert (folder / "index.html").read_bytes() == before


def test_a_folder_without_anything_is_told(tmp_path):
    (tmp_path / "published").mkdir()
    (tmp_path / "published" / "table1_shapenet.csv").write_text("row\n")
    with pytest.raises(ViewnetError, match="no tables and no figures"):
        page.write(tmp_path)


# The committed page


@pytest.fixture(scope="module")
def committed() -> list[page.Section]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("viewnet.experiments.page.images.encode", lambda frame, **options: "data:image")
        return page.sections(COMMITTED)


def test_every_committed_file_has_its_place(committed):
    shown = set()
    for section in committed:
        for setting in section.settings:
            shown |= {COMMITTED / file for file in setting.files}
            shown |= {COMMITTED / file for image in setting.images for file in image.files}
    there = {p for p in COMMITTED.rglob("*") if p.is_file() and "published" not in p.parts}
    there -= set(COMMITTED.rglob("*_logs.csv"))  # what curves are drawn from
    assert shown == there - {COMMITTED / name for name in ("index.html", claims.NAME)}
    assert "other" not in {section.name for section in committed}


def test_every_committed_setting_has_a_title(committed):
    named = {setting.name for section in committed for setting in section.settings} - {""}
    assert named == set(page.RULES["titles"])


UNCOMMITTED: dict[tuple[str, str], int] = {}
"""Runs of code that was not committed, to be made again: none may be added."""


def test_no_other_number_is_of_code_that_was_not_committed(committed):
    changed = {
        (section.name, setting.name): sum("changed" in origin["commit"] for origin in setting.origins)
        for section in committed
        for setting in section.settings
    }
    assert {place: count for place, count in changed.items() if count} == UNCOMMITTED


def test_every_number_of_a_committed_table_is_on_the_page(committed):
    tables = {(s.name, t.name): t.content.blocks[0] for s in committed for t in s.settings if s.chapter == "Tables"}
    for setting in next(s for s in committed if s.name == "your_method").settings:
        place, blocks = f"your_method/{setting.name}", setting.content.blocks
        names = sorted(path.stem for path in (COMMITTED / place).glob("*.json"))
        tables |= {(name, place): block for name, block in zip(names, blocks, strict=True)}
    needed: Counter[str] = Counter()
    for path in COMMITTED.rglob("table*.json"):
        setting = path.parent.relative_to(COMMITTED).as_posix()
        block = tables[path.stem, "" if setting == "." else setting]
        shown = [cell for _, rows in block.parts for cells in rows.values() for cell in cells if cell]
        shown = [cell for cell in shown if cell["printed"] or not np.isnan(cell["measured"])]
        listed = [c for c in json.loads(path.read_text())["cells"] if c["printed"] or c["measured"] is not None]
        order = list(dict.fromkeys(c["metric"] for c in listed))
        listed.sort(key=lambda c: order.index(c["metric"]))
        assert [cell["printed"] for cell in shown] == [c["printed"] for c in listed]
        assert [cell["measured"] for cell in shown if not np.isnan(cell["measured"])] == [
            c["measured"] for c in listed if c["measured"] is not None
        ]
        measured = [c for c in listed if c["measured"] is not None]
        needed.update(f"{c['measured']:.{METRICS[c['metric']].page_digits}f}" for c in measured)
    numbers = re.findall(r'<span(?: class="best")?>\(?(-?[\d.]+)\)?</span> ?(?:<small>|</td>)', page.render(committed))
    assert not needed - Counter(numbers)


def test_the_committed_page_is_of_the_committed_files(committed):
    """Images apart, whose bytes differ with the version of the library that encodes them."""
    text = (COMMITTED / "index.html").read_text(encoding="utf-8")
    there = re.sub(r"data:image/webp;base64,[A-Za-z0-9+/=]+", "data", text)
    now = page.render(committed, claims.judge(COMMITTED)).replace("data:image", "data")
    assert there == now, "run viewnet tables --page"


def test_a_list_of_categories_and_of_seeds_is_told(folder):
    cells = [cell("ViewNet", c, 80.0 + i, sd=1.5, seeds=3, runs=["0" * 12, "1" * 12]) for i, c in enumerate("abcdef")]
    table(folder, cells=cells)
    page = written(folder)
    assert "80.0: 50 images of 10 objects, mean of 3 seeds, sd 1.5; runs: 000000000000 111111111111" in [
        td.get("title") for td in page.all("td")
    ]
    assert [th.get("scope") for th in page.all("th")].count("colgroup") == 6
    assert [td.get("class") for td in page.all("td")].count("ours") == 6
