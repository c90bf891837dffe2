"""Every reader on damaged and on malicious files: a result, or one error that names the file.

`python benchmarks/fuzz.py` draws thousands of the first kind.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from helpers.damage import hostile_text
from helpers.hostile import CANARY, CASES
from helpers.kept_readers import KEPT
from helpers.readers import READERS, Reader, contents
from helpers.survival import Broken, survives
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from viewnet.errors import ViewnetError
from viewnet.experiments import experiment
from viewnet.model.checkpoint import fewest_weights
from viewnet.model.viewnet import ViewNet
from viewnet.recipes import VARIANTS, make_config

EVERY = {reader.name: reader for reader in (*READERS, *KEPT)}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A valid input of each reader, written once: reader -> its folder."""
    folders: dict[str, Path] = {}

    def of(reader: Reader) -> Path:
        if reader.name not in folders:
            folder = tmp_path_factory.mktemp("fuzz") / "input"
            folder.mkdir()
            reader.write(folder)
            folders[reader.name] = folder
        return folders[reader.name]

    return of


@pytest.mark.parametrize("reader", EVERY.values(), ids=EVERY)
def test_what_is_not_spoilt_is_read(written, reader):
    folder = written(reader)
    assert survives(lambda: reader.read(folder), ()).result is not None


@pytest.mark.parametrize("reader", EVERY.values(), ids=EVERY)
def test_spoilt_files_end_in_a_result_or_an_error_that_names_them(written, reader):
    folder = written(reader)
    files = reader.spoilt(folder)
    originals = {file: file.read_bytes() for file, _ in files}

    # Shrinking would read hundreds of files more; the report of one that fails is enough.
    @settings(max_examples=24, phases=[Phase.generate], suppress_health_check=list(HealthCheck))
    @given(st.data())
    def read_all(data: st.DataObject) -> None:
        file, other = data.draw(st.sampled_from(files))
        file.write_bytes(data.draw(contents(originals[file], other)))
        try:
            survives(lambda: reader.read(folder), reader.places(folder, file))
        finally:
            file.write_bytes(originals[file])

    read_all()


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.reader}: {case.name}")
def test_files_made_to_do_harm(written, tmp_path, case):
    reader = EVERY[case.reader]
    folder = shutil.copytree(written(reader), tmp_path / "input")
    file = case.spoil(folder)
    outcome = survives(lambda: reader.read(folder), reader.places(folder, file))
    assert case.says in (str(outcome.error) if outcome.error else str(outcome.result))
    assert not (tmp_path / CANARY).exists()


TEXTS = ("profile", "categories", "seeds", "recipe", "rows", "data_root", "splits", "viewpoints", "output")


@given(
    st.dictionaries(st.sampled_from(TEXTS), st.one_of(hostile_text, st.sampled_from(["9" * 12, "0," * 3])), min_size=1)
)
@example({"seeds": "9" * 12})
@example({"data_root": "~nobody-of-this-name/x"})
@example({"data_root": "a\0b"})
@example({"output": "~nobody-of-this-name"})
@example({"viewpoints": "a" * 5000})
def test_parameters_of_notebooks(values):
    names = [*values, *(name.removesuffix("s") for name in values), "categor"]
    survives(lambda: experiment("table2_ablation", **values), names)


@pytest.mark.parametrize("profile", ["smoke", "tiny", "small"])
def test_no_network_is_taken_for_a_larger_one_than_its_checkpoint(profile):
    for variant in VARIANTS:
        config = make_config(variant, profile=profile).model
        weights = sum(weight.numel() for weight in ViewNet(config).state_dict().values())
        assert fewest_weights(config) <= weights < 200 * fewest_weights(config), variant


def test_what_breaks_the_promise_is_seen(tmp_path):
    def fill() -> object:
        return bytearray(b"x" * (2**30 + 2**26))

    with pytest.raises(Broken, match="MiB of memory"):
        survives(fill, ())
    with pytest.raises(Broken, match="KeyError"):
        survives(lambda: {}["a"], ())
    with pytest.raises(Broken, match="RuntimeWarning"):
        survives(lambda: __import__("numpy").float32(1e30) ** 2, ())

    def refuse(message: str) -> None:
        raise ViewnetError(message)

    for message, problem in (("no file", "names none of"), (f"a {'x' * 3000}", "characters"), ("a \udcff", "written")):
        with pytest.raises(Broken, match=problem):
            survives(lambda message=message: refuse(message), ["a"])
    assert str(survives(lambda: refuse("a is damaged"), ["a"]).error) == "a is damaged"
