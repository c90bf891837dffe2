"""Code and commands in the documents work: commands are parsed and run, Python runs, and names exist."""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib
import json
import os
import re
import shlex
import shutil
import tomllib
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import documents, imagenet3d_files
from helpers.cad_files import write_box
from helpers.documents import NOTEBOOKS, PAGES, ROOT
from helpers.fake_steps import STEPS
from helpers.photo_data import keep_apart, make_photos
from helpers.untrained_models import finished_run
from helpers.video_data import write_frames
from PIL import Image

from viewnet import cli, config, recipes
from viewnet.data import catalogue
from viewnet.data.store import ViewStore
from viewnet.experiments import notebooks, request, score_model
from viewnet.runs.run_store import ensure
from viewnet.runtime import torchvision_weights
from viewnet.training.adapt import Adaptation

KEY = "0123456789ab"
FOREIGN = {"apptainer", "dask", "docker", "helm", "kubectl", "sbatch", "srun"}
"""Programs of clusters and containers, whose options are not checked."""
OTHER = ("category,model_id,view,", "target  rgb alpha")
"""How blocks begin that are neither Python nor commands: a file's first lines, a formula."""
HISTORY = "CHANGELOG.md"
"""It names things that no longer exist."""

BLOCKS = [(page, block) for page in PAGES for block in page.blocks]
SPANS = [(page, span) for page in [*PAGES, *NOTEBOOKS] for span in dict.fromkeys(page.spans)]


def commands(text: str) -> list[list[str]]:
    """The commands of a block, word by word: comments left out, continued lines and quoted lines joined."""
    found, begun = [], ""
    for line in text.splitlines():
        begun += line
        try:
            if begun.endswith("\\"):
                raise ValueError
            words = shlex.split(begun, comments=True)
        except ValueError:  # a quotation is open
            begun = begun.removesuffix("\\") + "\n"
            continue
        begun = ""
        found.append([word.removeprefix(".venv/bin/") for word in words if word != "&"])
    assert not begun
    return [words for words in found if words]


def is_commands(block) -> bool:
    return not block.language and not block.text.startswith(OTHER)


def given(kind: str) -> list:
    """The commands of every block of the documents, and of `viewnet --help`, that start with a program."""
    shown = [(page.name, words) for page, block in BLOCKS if is_commands(block) for words in commands(block.text)]
    found = [(name, words) for name, words in shown if words[0] == kind]
    return [pytest.param(words, id=f"{name}: {' '.join(words)[:60]}") for name, words in found]


@pytest.fixture
def world(tmp_path, monkeypatch) -> Path:
    """A working directory with what the examples name: a finished run KEY, images, a list, folders below /data."""
    keep_apart(tmp_path, monkeypatch)
    monkeypatch.setenv("VIEWNET_CLUSTER", "")  # what a command sets goes with the test
    monkeypatch.chdir(tmp_path)
    store = made(tmp_path / "views", lambda folder: box_views(folder))
    for place in ("KEY", f"runs/viewnet/{KEY}"):
        finished_run(tmp_path / place, store)
    for number, name in enumerate(("street.jpg", "yard.jpg", "car.jpg", "a.jpg", "b.jpg", "car.png")):
        pixels = np.random.default_rng(number).integers(0, 255, (300, 400, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(tmp_path / name)
    for name in ("a_mask.png", "b_mask.png"):
        Image.fromarray(np.full((300, 400), 255, np.uint8)).save(tmp_path / name)
    for split, name in (("train", "a"), ("val", "b")):
        imagenet3d_files.write(tmp_path / "data/imagenet3d", name, imagenet3d_files.thing())
        imagenet3d_files.listed(tmp_path / "data/imagenet3d", split, name)
    shutil.copytree(tmp_path, tmp_path / "photos", ignore=shutil.ignore_patterns("[!a-b]*", "*_mask.png"))
    for place in (".", "photos"):
        (tmp_path / place / "boxes.csv").write_text("image,x0,y0,x1,y1\na.jpg,40,60,380,250\nb.jpg,40,60,380,250\n")
    for number in range(5):
        write_frames(tmp_path / f"turntables/mug{number}", {"0.png": 50, "1.png": 90})
        write_box(tmp_path / "mugs", "", f"mug{number}", "v1")
    write_box(tmp_path / "data/ShapeNetCore.v1", config.SYNSETS["car"], "box", "v1")
    (tmp_path / "FILE").write_text("category,azimuth_deg,elevation_deg\ncar,10,5\ncar,200,10\n")
    return tmp_path


def made(folder: Path, make) -> ViewStore:
    return ViewStore.open(folder) if folder.exists() else make(folder)


def photographs(world: Path):
    """A few photographs, as a store."""
    return made(world / "photographs", lambda folder: make_photos(folder, size=32))


def box_views(folder: Path) -> ViewStore:
    from helpers.boxes import box_store

    return box_store(folder, {"val": 2, "test": 2}, views=3)


def moved(words: list[str], world: Path) -> list[str]:
    """The same with what lies in /data in the test's folder, and made; saved models and a run's folder there, too."""
    for word in words:
        for name in re.findall(r"/data/[\w.+]+", word):
            (world / name[1:]).mkdir(parents=True, exist_ok=True)
    places = {
        "saved/car": "KEY",
        "saved/motorbike": "KEY",
        "calibrated/motorbike": "KEY",
        "my-car": "KEY",
        "my-mug": "KEY",
        "*.png": "car.png",
        f"runs/viewnet/{KEY}": f"runs/viewnet/{KEY}",
    }
    places["docs/car.jpg"] = str(ROOT / "docs" / "car.jpg")
    found = [places.get(word, word.replace("/data/", f"{world}/data/")) for word in words]
    return [*found[:2], "written", *found[3:]] if words[0] == "save" else found


def run_command(words: list[str], world: Path, monkeypatch) -> None:
    """Run a `viewnet` command with its slow parts replaced: training, notebooks, measurements and serving."""
    requests = []
    page = SimpleNamespace(local_url="here", share_url=None, block_thread=lambda: None)
    monkeypatch.setattr("viewnet.commands.demo.start", lambda options: requests.append(options) or page)
    monkeypatch.setattr("viewnet.runs.run_store.ensure", lambda configs, workers=None: requests.extend(configs) or [])
    monkeypatch.setattr("papermill.execute_notebook", lambda source, *_, **__: requests.append(source))
    result = SimpleNamespace(about={"metrics": None})
    monkeypatch.setattr("viewnet.experiments.distilled.make", lambda *what: requests.append(what) or result)
    found = Adaptation(80, 20, 0.8, 0.9, 1.0, 1.0)
    monkeypatch.setattr("viewnet.experiments.adapted.make", lambda *what: requests.append(what) or found)
    monkeypatch.setattr("viewnet.bench.measure.measure", lambda settings: requests.append(settings) or {})
    monkeypatch.setattr("viewnet.bench.steps.measure", lambda configs, settings: requests.append(settings) or {})
    for name in ("as_text", "steps_as_text"):
        monkeypatch.setattr(f"viewnet.bench.report.{name}", lambda found: "measured")
    for name in ("write", "write_steps"):
        monkeypatch.setattr(f"viewnet.bench.report.{name}", lambda found, folder: [folder])
    monkeypatch.setattr("viewnet.data.build.photo_views", lambda *_, **__: photographs(world))
    # The last value of an option counts: two images of a turntable instead of 48.
    words, output = (words[:-2], words[-1]) if ">" in words else (words, os.devnull)
    if "--scores" in words:
        Path("scores.json").write_text(json.dumps(score_model.scores("KEY")))
    with open(output, "w") as file, contextlib.redirect_stdout(file):
        assert cli.main([*moved(words, world), *(["--steps", "2"] if words[0] == "turntable" else [])]) == 0
    if words[-1] == "--json":
        assert json.loads(Path(output).read_text())
    if words[0] in ("train", "distil", "adapt", "notebook", "bench", "demo") and "--parameters" not in words:
        assert requests


@pytest.mark.parametrize("words", given("viewnet"))
@pytest.mark.slow
def test_viewnet_commands_run(words, world, monkeypatch):
    run_command(words[1:], world, monkeypatch)


@pytest.mark.parametrize("words", given("torchrun"))
def test_torchrun_commands_run(words, world, monkeypatch):
    from torch.distributed.run import get_args_parser

    found = get_args_parser().parse_args(words[1:])
    assert (found.module, found.training_script) == (True, "viewnet")
    run_command(found.training_script_args, world, monkeypatch)


@pytest.mark.parametrize("words", given("papermill"))
def test_papermill_parameters_exist(words, world):
    source, _, *rest = words[1:]
    assert rest[::3] == ["-p"] * (len(rest) // 3)
    notebooks.check((ROOT / source).stem, list(zip(rest[1::3], rest[2::3], strict=True)))


@pytest.mark.parametrize("words", given("python"))
def test_programs_exist_with_these_options(words):
    if words[1] == "-c":
        ast.parse(words[2])
        return
    assert check_program(words[1:]) is None


def check_program(words: list[str]) -> str | None:
    """The problem with one of the project's programs, or modules after -m, and its options, or None."""
    if words[0] == "-m":
        words = [f"{words[1].replace('.', '/')}.py", *words[2:]]
    if not (ROOT / words[0]).is_file():
        return "no such file"
    source = (ROOT / words[0]).read_text()
    unknown = [word for word in words[1:] if word.startswith("-") and f'"{word}"' not in source]
    return f"no option {unknown[0]}" if unknown else None


def check_make(words: list[str]) -> str | None:
    makefile = (ROOT / "Makefile").read_text()
    for word in words:
        name, variable, _ = word.partition("=")
        if word != "..." and not re.search(rf"^{name} \?=" if variable else rf"^{name}:.*## ", makefile, re.MULTILINE):
            return f"no such {'variable' if variable else 'target'}: {name}"
    return None


@pytest.mark.parametrize("words", given("make"))
def test_make_has_the_targets(words):
    assert check_make(words[1:]) is None


def check_viewnet(words: list[str]) -> str | None:
    """The problem with a command within a sentence, often only its beginning, or None."""
    try:
        cli.parser().parse_args(words if len(words) > 1 else [*words, "--help"])
    except SystemExit as ended:
        return f"refused: {words}" if ended.code else None
    return None


def check_torchrun(words: list[str]) -> str | None:
    from torch.distributed.run import get_args_parser

    known = get_args_parser()._option_string_actions
    unknown = [word for word in words if word.startswith("--") and word not in known]
    return f"no option {unknown[0]}" if unknown else None


def check_pip(words: list[str]) -> str | None:
    """Extras of the package only."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    requests = [re.fullmatch(r"(?:viewnet|\.)\[(\w+)\]", word) for word in words]
    unknown = [found[1] for found in requests if found and found[1] not in extras]
    return f"no extra {unknown[0]}" if unknown else None


def check_setting(words: list[str]) -> str | None:
    """-p NAME VALUE of a notebook, -s NAME=VALUE of a run."""
    for kind, word in pairwise(words):
        if kind == "-p" and word not in PARAMETERS:
            return f"no notebook has a parameter {word}"
        if kind == "-s" and word.partition("=")[0] not in FIELDS:
            return f"no setting {word}"
    return None


CHECKS = {
    "viewnet": check_viewnet,
    "make": check_make,
    "torchrun": check_torchrun,
    "pip": check_pip,
    "python": check_program,
}
FIELDS = {name for name, _ in config.settings()} | {
    name for kind in (config.PhotoConfig, config.VideoConfig) for name in kind.__dataclass_fields__
}
PARAMETERS = {name for design in request.DESIGNS for name in request.accepted(design)}
COLUMN = r"(h|up)\d_[xyz]|logit_\d"
"""Of predictions, whose number is that of a hypothesis."""
CHOICES = {*recipes.RECIPES, *recipes.PROFILES, *recipes.VARIANTS, "code"}


def test_commands_within_sentences_exist():
    wrong = {}
    for page, span in SPANS:
        words = shlex.split(span) if span.split(" ")[0] in {*CHECKS, "-p", "-s"} else [""]
        check = check_setting if words[0] in ("-p", "-s") else CHECKS.get(words[0])
        if check is not None and (why := check(words if check is check_setting else words[1:])):
            wrong[page.name, span] = why
    assert wrong == {}


def test_every_block_is_of_a_kind_that_is_checked():
    checked = {"viewnet", "torchrun", "papermill", "python", "make", *FOREIGN}
    for page, block in BLOCKS:
        assert block.language in ("", "text", "python", "bibtex", "mermaid"), page.name
        if is_commands(block):
            assert {words[0] for words in commands(block.text)} <= checked, page.name
    assert {"viewnet", "torchrun", "papermill", "python", "make"} <= {
        words[0] for _, block in BLOCKS if is_commands(block) for words in commands(block.text)
    }


PYTHON = [pytest.param(b.text, id=f"{p.name}: {b.text.splitlines()[0]}") for p, b in BLOCKS if b.language == "python"]


@pytest.mark.parametrize("source", PYTHON)
@pytest.mark.slow
def test_python_runs(source, world, monkeypatch, capsys):
    monkeypatch.setenv("VIEWNET_PROFILE", "smoke")
    monkeypatch.setattr("viewnet.experiments.cad.ensure", lambda configs, *_: ensure(configs, 1, False, STEPS))
    monkeypatch.setattr("viewnet.runs.make_run.default_steps", lambda: STEPS)
    monkeypatch.setattr("viewnet.data.build.photo_views", lambda *_, **__: photographs(world))
    monkeypatch.setattr("viewnet.data.photo_store.summary", lambda store: f"{len(store)} photographs")
    names = {"my_network": lambda images: (images.mean((1, 2, 3)), np.zeros(len(images)))}
    exec(compile(source.replace("steps=1000", "steps=10"), "example", "exec"), names)
    assert len(names) > 2


@pytest.mark.slow
def test_the_image_of_the_cameras_axes_is_drawn(tmp_path):
    documents.script("camera_axes").main(tmp_path / "axes.png")
    with Image.open(tmp_path / "axes.png") as drawn, Image.open(ROOT / "docs" / "camera_axes.png") as shown:
        assert drawn.size == shown.size
        assert np.asarray(drawn.convert("L")).std() > 20  # not an empty page


def strings(path: Path) -> set[str]:
    """Every string of a Python file, whole, and every name in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value)
        for name in ("id", "attr", "name", "arg"):
            found.add(getattr(node, name, None))
    return found


@functools.cache
def package() -> set[str]:
    """Names of the package's modules, and every name and string in them."""
    modules = sorted((ROOT / "viewnet").rglob("*.py"))
    return {path.stem for path in modules}.union(*(strings(path) for path in modules))


@functools.cache
def beside() -> set[str]:
    """The same of tests, benchmarks and docs."""
    return set().union(
        *(strings(path) for name in ("tests", "benchmarks", "docs") for path in (ROOT / name).rglob("*.py"))
    )


VARIABLES = r"VIEWNET_[A-Z0-9]+(?:_[A-Z0-9]+)*"


def test_documents_and_package_name_the_same_environment_variables():
    documented = set().union(*(re.findall(VARIABLES, page.text) for page in PAGES))
    weights = {torchvision_weights.variable(network) for network in catalogue.NETWORKS}
    assert documented <= {name for name in package() | beside() if name} | weights
    read = {name for name in package() if name and re.fullmatch(VARIABLES, name)}
    assert {"VIEWNET_ROOT", "VIEWNET_RENDERER", "VIEWNET_TENSORBOARD"} <= read
    assert read <= documented


def test_names_of_the_package_exist():
    names = {(page.name, span) for page, span in SPANS if re.match(r"viewnet(\.\w+)+", span) and page.name != HISTORY}
    assert len(names) > 5
    for page, span in sorted(names):
        parts = re.match(r"viewnet(?:\.\w+)+", span)[0].split(".")
        found = importlib.import_module("viewnet")
        for end, part in enumerate(parts[1:], 2):
            if not hasattr(found, part):
                importlib.import_module(".".join(parts[:end]))
            found = getattr(found, part)
            assert found is not None, (page, span)


def test_the_changelog_names_modules_that_exist():
    rows = documents.page(HISTORY).table("before", "now")
    assert len(rows) > 20
    for _, now in rows:
        for name in re.findall(r"viewnet[\w.]+", now):
            assert importlib.import_module(name)


def test_files_exist():
    folders = ("viewnet", "tests", "docs", "benchmarks", "notebooks", "paper_tables")
    names = [(page, span) for page, span in SPANS if re.fullmatch(rf"({'|'.join(folders)})/[\w./{{}},-]*", span)]
    assert len(names) > 10
    for page, span in names:
        start, braces, rest = span.partition("{")
        endings, _, _ = rest.partition("}")
        for ending in endings.split(",") if braces else [""]:
            assert (ROOT / f"{start}{ending}").exists(), (page.name, span)


def test_settings_and_other_identifiers_exist():
    """Identifiers in docs/decisions.md are settings."""
    settable = FIELDS | PARAMETERS | CHOICES
    wrong = set()
    for page, span in SPANS:
        if not re.fullmatch(r"[a-z]\w*", span) or re.fullmatch(COLUMN, span) or page.name == HISTORY:
            continue
        known = settable if page.name == "docs/decisions.md" else settable | package() | beside()
        if span not in known and ("_" in span or page.name == "docs/decisions.md"):
            wrong.add((page.name, span))
    assert wrong == set()


@pytest.mark.parametrize(
    ("check", "words"),
    [
        (check_viewnet, ["predicts"]),
        (check_viewnet, ["bench", "--accuracy"]),
        (check_make, ["table9"]),
        (check_make, ["COLOUR=red", "test"]),
        (check_torchrun, ["--processes", "4"]),
        (check_pip, ["install", "viewnet[hubs]"]),
        (check_program, ["benchmarks/nothing.py"]),
        (check_program, ["benchmarks/fuzz.py", "--casts", "3"]),
        (check_setting, ["-p", "sede", "3"]),
        (check_setting, ["-s", "epoch=3"]),
    ],
)
def test_errors_are_noticed(check, words):
    assert check(words)


def test_commands_are_taken_from_blocks_as_a_shell_would():
    text = "a b \\\n  c  # and so on\n\npython -c \"x = 1\ny\" &\n# nothing\nd 'e f'"
    assert commands(text) == [["a", "b", "c"], ["python", "-c", "x = 1\ny"], ["d", "e f"]]
