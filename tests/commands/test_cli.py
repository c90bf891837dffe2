from __future__ import annotations

import importlib.metadata
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.fake_steps import STEPS

from viewnet import cli
from viewnet.commands.options import NAMED, configurations
from viewnet.config import RunConfig, VideoConfig, settings
from viewnet.data import build
from viewnet.data.store import ViewStore
from viewnet.experiments import notebooks
from viewnet.recipes import make_config
from viewnet.runs import make_run
from viewnet.runtime.files import read_json

COMMANDS = (
    *("notebook", "tables", "render", "train", "evaluate", "predict", "turntable", "distil", "adapt", "save", "demo"),
    *("runs", "data", "audit", "bench", "completion"),
)


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    monkeypatch.setenv("VIEWNET_RUNS", str(tmp_path / "runs"))
    monkeypatch.setenv("VIEWNET_DATA", str(tmp_path / "data"))
    monkeypatch.delenv("VIEWNET_CLUSTER", raising=False)
    monkeypatch.setattr(make_run, "default_steps", lambda: STEPS)
    return tmp_path


def test_train_prints_runs_and_scores(folders, capsys):
    arguments = ["train", "car", "chair", "--profile", "smoke", "--seed", "3", "--workers", "1"]
    arguments += ["-s", "epochs=5", "-s", "amp=off", "-s", "betas=[0.8, 0.9]"]
    assert cli.main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines[::2]] == [
        "viewnet car seed 3 (smoke, matting)",
        "viewnet chair seed 3 (smoke, matting)",
    ]
    (config,) = folders.glob(f"runs/viewnet/{lines[0].rpartition('/')[2]}/config.json")
    made = RunConfig.from_dict(read_json(config))
    assert (made.train.epochs, made.train.amp, made.train.optimiser.betas) == (5, "off", (0.8, 0.9))
    assert lines[1].startswith("  test: within 30 degrees ")


def test_of_several_seeds_the_one_that_reconstructs_best_is_said(folders, capsys):
    train = ["train", "--profile", "smoke", "--workers", "1", "--seeds"]
    assert cli.main([*train, "2,1,0", "car", "chair"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len([line for line in lines if line.startswith("  test")]) == 6
    assert [line.partition(" reconstructs")[0] for line in lines[-2:]] == [
        "viewnet car seed 1 (smoke, matting)",
        "viewnet chair seed 1 (smoke, matting)",
    ]
    assert cli.main([*train, "1", "car"]) == 0
    assert "reconstructs" not in capsys.readouterr().out


def test_threads_are_told_to_openmp_before_its_libraries_are_imported(folders):
    code = "import sys; from viewnet import cli; status = cli.main(sys.argv[1:]); import torch; "
    code += "print(status, torch.get_num_threads())"
    arguments = [sys.executable, "-c", code, "notebook", "table2_ablation", "--parameters", "--threads", "1"]
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.splitlines()[-1] == "0 1"
    refused = subprocess.run(arguments, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "junk"})
    assert refused.stderr.startswith(
        "viewnet: OMP_NUM_THREADS=junk: expected a whole number from 1 to 1024, or nothing"
    )


def test_train_as_json_has_every_metric(folders, capsys):
    assert cli.main(["train", "car", "--profile", "smoke", "--workers", "1", "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)
    (result,) = folders.glob(f"runs/viewnet/{told['key']}/result.json")
    assert told == {"folder": str(result.parent), **read_json(result)}


def test_train_reports_runs_that_are_not_scored(capsys, monkeypatch):
    def opened(folder):
        store = STEPS.open(folder)
        return replace(store, index=store.index[store.index["split"] == "train"])

    monkeypatch.setattr(make_run, "default_steps", lambda: replace(STEPS, open=opened))
    assert cli.main(["train", "car", "--profile", "smoke", "--workers", "1"]) == 0
    assert "  not scored: its own views have no annotated val and test split" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "cart"], "unknown category 'cart'"),
        (["train", "car", "-s", "epochs"], "-s epochs: expected NAME=VALUE"),
        (["train", "car", "-s", "epoch=3"], "unknown setting 'epoch'"),
        (["train", "car", "-s", "seed=3"], "-s seed=3: seed is no setting here: it has an argument of its own"),
        (["train", "car", "-s", "epochs=many"], "config.train.epochs: expected int"),
        (["train", "car", "--seeds", "0,x"], "seeds '0,x': expected how many (3) or which (0,2)"),
        (["train", "car", "--data-root", "nowhere"], "data_root nowhere: no such folder"),
        (["train", "car", "--threads", "0"], "--threads 0: expected 1 to 1024"),
        (["train", "car", "--threads", "-1"], "--threads -1: expected 1 to 1024"),
        (["train", "car", "--workers", "0"], "--workers 0: expected 1 to 1024"),
        (["render", "car", "--workers", "100000"], "--workers 100000: expected 1 to 1024"),
        (["replicate", "--workers", "100000"], "--workers 100000: expected 1 to 1024"),
        (["notebook", "table2_ablation", "--threads", "1025"], "--threads 1025: expected 1 to 1024"),
        (["predict", "a.png", "--model", "car", "--threads", "0"], "--threads 0: expected 1 to 1024"),
        (["train", "car", "--threads", "2", "--cluster", "tcp://a:1"], "--threads: workers of a cluster"),
        (["train", "car", "--cluster", "scheduler-file:nowhere"], "cluster scheduler-file:nowhere: "),
    ],
)
def test_errors_of_training(arguments, message, capsys, monkeypatch):
    monkeypatch.setenv("VIEWNET_CLUSTER", "")  # what the command sets goes with the test
    assert cli.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"viewnet: {message}")
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["train", "cart"], "car"),
        (["train", "Airplane"], "aeroplane"),
        (["train", "car", "--variant", "viewnet_cycles"], "viewnet_cycle"),
        (["train", "car", "--recipe", "mating"], "matting"),
        (["train", "car", "--profile", "tny"], "tiny"),
        (["train", "car", "-s", "search_view=3"], "search_views"),
        (["train", "car", "-s", 'video={"category": "car", "mask": "none"}'], "masks"),
        (["predict", "a.png", "--model", "chiar"], "chair"),
        (["evaluate", "airplane"], "aeroplane"),
        (["notebook", "tabel2_ablation"], "table2_ablation"),
        (["notebook", "table2_ablation", "-p", "profle", "tiny"], "profile"),
        (["tables", "--only", "table1_shapnet"], "table1_shapenet"),
    ],
)
def test_the_name_that_may_be_meant_is_said(arguments, meant, capsys):
    assert cli.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.endswith(f". Did you mean {meant!r}?\n")
    assert said.count("\n") == 1


def test_train_lists_every_setting_as_it_takes_it(capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["train", "--settings"])
    assert end.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.partition("=")[0] for line in lines} == {name for name, _ in settings()} - {*NAMED}
    words = [word for line in lines for word in ("-s", line)]
    assert configurations(cli.parser().parse_args(["train", "car", *words])) == [make_config()]


def test_the_stand_in_for_videos_is_no_folder(tmp_path):
    words = ["train", "car", "--data", str(tmp_path), "-s", 'video={"category": "car"}']
    (config,) = configurations(cli.parser().parse_args(words))
    assert (config.data.root, config.data.video) == (str(tmp_path), VideoConfig("car"))


WRONG = (
    ("epochs=-1", "epochs -1: expected 1 to 1000000"),
    ("validate_every=0", "validate_every 0: expected 1 to 1000000"),
    ("volume_size=33", "volume_size 33: expected a power of two of 8 or more"),
    ("encoder_channels=[8]", "encoder_channels (8,): 5 are needed for images of 32 pixels"),
    ("generator_channels=[8]", "generator_channels (8,): 2 are needed for a volume of 16 voxels a side"),
)
OF_TRAINING = (
    ("views=1", "views 1: training needs two or more of every model"),
    ("start=nowhere", "start nowhere: no finished run of that key or folder"),
)


@pytest.mark.parametrize(
    ("command", "setting", "message"),
    [("train", *each) for each in (*WRONG, *OF_TRAINING)] + [("render", *each) for each in WRONG],
)
def test_settings_are_checked_before_anything_is_rendered(command, setting, message, capsys, monkeypatch):
    rendered = []
    steps = replace(STEPS, views=lambda *given, **how: rendered.append(given) or STEPS.views(*given, **how))
    monkeypatch.setattr(make_run, "default_steps", lambda: steps)
    arguments = [command, "car", "--profile", "smoke", "-s", setting]
    assert cli.main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"viewnet: {message}") and said.count("\n") == 1
    assert not rendered


@pytest.mark.parametrize(
    ("arguments", "lines"),
    [
        (["render", "car", "--profile", "smoke"], ["views: 0 of 1 kept, about 0.6 MB to make"]),
        (
            ["train", "car", "--profile", "smoke"],
            ["views: 0 of 1 kept, about 0.6 MB to make", "runs: 0 of 1 kept, about 0.2 MB to make"],
        ),
        (
            ["notebook", "table2_ablation", "-p", "profile", "smoke", "-p", "categories", "car"],
            ["views: 0 of 1 kept, about 0.6 MB to make", "runs: 0 of 10 kept, about 1.2 MB to make"],
        ),
        (
            ["notebook", "objectron", "-p", "profile", "smoke"],
            ["views: 0 of 3 kept, at least 1.2 MB to make", "runs: 0 of 3 kept, about 0.5 MB to make"],
        ),
        (["notebook", "architecture"], []),
        (
            ["tables", "--profile", "smoke", "--only", "figure3_azimuth", "training_curves"],
            ["views: 0 of 2 kept, about 1.2 MB to make", "runs: 0 of 14 kept, about 2.4 MB to make"],
        ),
    ],
)
def test_a_dry_run_makes_nothing_and_says_what_would_be_made(arguments, lines, folders, capsys, monkeypatch):
    def fail(*_, **__):
        pytest.fail("something is made")

    monkeypatch.setattr(make_run, "default_steps", fail)
    monkeypatch.setattr(notebooks, "run", fail)
    monkeypatch.setenv("VIEWNET_TABLES", str(folders / "tables"))
    assert cli.main([*arguments, "--dry-run"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert [line for line in said if line.startswith(("views", "runs"))] == lines
    assert sum(line.startswith("  missing: ") for line in said) == sum(int(line.split()[3]) for line in lines)
    assert list(folders.iterdir()) == []


def test_a_notebook_s_kernel_gets_the_cluster(monkeypatch, capsys):
    monkeypatch.setenv("VIEWNET_CLUSTER", "")
    monkeypatch.setattr(notebooks, "run", lambda *_: os.environ["VIEWNET_CLUSTER"])
    assert cli.main(["notebook", "table2_ablation", "--cluster", "tcp://host:8786"]) == 0
    assert capsys.readouterr().out == "tcp://host:8786\n"


def test_render_makes_the_views_of_training(folders, capsys, monkeypatch):
    monkeypatch.undo()  # real views, small ones
    monkeypatch.setenv("VIEWNET_DATA", str(folders / "data"))
    arguments = ["car", "--profile", "smoke", "-s", "models=10", "-s", "views=2", "-s", "image_size=16"]
    assert cli.main(["render", *arguments, "--workers", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    store = ViewStore.open(lines[0].removeprefix("car: "))
    assert lines[1] == "  20 views: 14 train (7 models), 4 test (2 models), 2 val (1 models)"
    asked = make_config(category="car", profile="smoke", models=10, views=2, image_size=16).data
    monkeypatch.setattr(build, "render_views", lambda *_, **__: pytest.fail("drawn again"))
    assert build.view_store(asked, progress=False).identity == store.identity
    assert cli.main(["render", *arguments, "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert (told["folder"], told["identity"], told["views"]) == (str(store.folder), store.identity, 20)
    assert told["splits"]["test"] == {"models": 2, "views": 4}
    assert (told["rejected"], told["backgrounds"]) == ([], 0)


def test_the_version_is_the_package_s(capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"viewnet {importlib.metadata.version('viewnet')}\n"


def test_the_help_names_every_command_and_exit_code(capsys):
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    said = capsys.readouterr().out
    for name in COMMANDS:
        assert re.search(rf"\n    {name}\s+\w", said)
    for code in (0, 1, 2, 3, 130, 141):
        assert f"\n  {code} " in said


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_has_enough_ends_a_command_without_a_traceback(unbuffered):
    read, write = os.pipe()
    os.close(read)
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    arguments = [sys.executable, "-m", "viewnet", "completion", "bash"]
    done = subprocess.run(arguments, stdout=write, stderr=subprocess.PIPE, text=True, env=environment)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_an_output_without_room_is_said_in_one_line():
    with open("/dev/full", "w") as full:
        arguments = [sys.executable, "-m", "viewnet", "completion", "bash"]
        done = subprocess.run(arguments, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (2, "viewnet: the standard output cannot be written: no space left\n")


def test_a_closed_standard_error_changes_nothing():
    python = f"{shlex.quote(sys.executable)} -m viewnet"
    commands = (f"{python} completion bash", f"{python} completion bash 2>&-")
    with_it, without = (subprocess.run(each, shell=True, capture_output=True, text=True) for each in commands)
    assert (without.returncode, without.stdout) == (0, with_it.stdout)
    refused = subprocess.run(f"{python} predict nowhere.jpg --model car 2>&-", shell=True, capture_output=True)
    assert (refused.returncode, refused.stdout) == (2, b"")


def test_a_file_that_reads_as_an_option_is_named_as_it_should_be(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("-front.jpg").touch()
    for word, advised in (("-front.jpg", True), ("-rear.jpg", False)):
        with pytest.raises(SystemExit):
            cli.main(["predict", "--model", "car", "a.jpg", word])
        assert (f"is written ./{word}" in capsys.readouterr().err) is advised


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_s_examples_are_ones_that_it_takes(command, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main([command, "--help"])
    assert end.value.code == 0
    examples = capsys.readouterr().out.partition("examples:\n")[2].strip().splitlines()
    lines = [
        line.partition("   ")[0].split("-m viewnet ")[-1].replace('eval "$(', "").replace(')"', "") for line in examples
    ]
    taken = []
    for line in lines:
        words = line.partition(" > ")[0].split()
        words = words[1:] if words[0] == "viewnet" else words
        assert cli.parser().parse_args(words).run
        taken.append(words[0])
    assert command in taken


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "COMMAND (see viewnet --help)"),
        (["train"], "CATEGORY (see viewnet train --help)"),
        (["bench", "--batch", "many"], "'many' (see viewnet bench --help)"),
        (["tables", "--pages"], "--pages (see viewnet --help)"),
        (["trian"], ". Did you mean 'train'? (see viewnet --help)"),
        (["predict", "a", "--as", "Quaternions"], ". Did you mean 'quaternion'? (see viewnet predict --help)"),
    ],
)
def test_a_wrong_command_line_is_reported_in_one_line(arguments, message, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main(arguments)
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("viewnet: ") and said.endswith(f"{message}\n")
    assert said.count("\n") == 1


def test_an_interruption_is_reported(capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(notebooks, "run", interrupted)
    assert cli.main(["notebook", "table2_ablation"]) == 130
    assert capsys.readouterr().err == "viewnet: interrupted: the same command continues where it stopped\n"


@pytest.fixture
def completed(tmp_path, capsys):
    """Bash's completions for an incomplete last word."""
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed")
    assert cli.main(["completion", "bash"]) == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out)
    (tmp_path / "place" / "photographs").mkdir(parents=True)
    (tmp_path / "place" / "photo.png").write_bytes(b"")

    def complete(*words: str) -> set[str]:
        ask = f'source {script}; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _shtab_viewnet; '
        ask += 'printf "%s\\n" "${COMPREPLY[@]}"'
        command = ["bash", "-c", ask, "bash", "viewnet", *words]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path / "place", timeout=60)
        assert done.returncode == 0, done.stderr
        return {word.rstrip("/ ") for word in done.stdout.split("\n") if word.strip()}

    return complete


def test_bash_completes_commands_options_names_and_files(completed):
    assert completed("t") == {"tables", "train", "turntable"}
    assert completed("train", "ca") == {"car"}
    assert completed("train", "car", "--prof") == {"--profile"}
    assert completed("train", "car", "--profile", "s") == {"smoke", "small"}
    assert completed("tables", "--only", "table1_shapenet", "table2") == {"table2_ablation"}
    assert completed("predict", "p") == {"photographs", "photo.png"}
    assert completed("train", "car", "--data-root", "p") == {"photographs"}
    assert completed("completion", "z") == {"zsh"}


@pytest.mark.parametrize(("shell", "begins"), [("zsh", "#compdef viewnet"), ("tcsh", "# AUTOMATICALLY GENERATED")])
def test_other_shells_have_their_scripts(shell, begins, capsys):
    assert cli.main(["completion", shell]) == 0
    said = capsys.readouterr().out
    assert said.startswith(begins)
    assert "turntable" in said
