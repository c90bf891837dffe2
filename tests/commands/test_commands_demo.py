from __future__ import annotations

import socket
import sys

import pytest
from helpers.boxes import box_store
from helpers.untrained_models import finished_run

from viewnet import cli


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo")
    return finished_run(folder / "run", box_store(folder / "views", {"val": 2, "test": 2}, views=2))


def test_without_gradio_the_message_says_what_to_install(run, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "gradio", None)
    assert cli.main(["demo", "--model", str(run.folder)]) == 2
    assert capsys.readouterr().err == 'viewnet: demo: gradio is not installed: pip install "viewnet[demo]"\n'


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--port", "99999"], "--port 99999: expected 1 to 65535"),
        (["--model", "ba9876543210"], "ba9876543210: no model there"),
        (["--host", "256.0.0.1"], "256.0.0.1:{port}: cannot listen there"),
        (["--host", "a..b"], "a..b:{port}: cannot listen there (no name of a host)"),
        (["--device", "abacus"], "device abacus: not available here"),
    ],
)
def test_errors_of_the_command(run, arguments, message, capsys):
    pytest.importorskip("gradio")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    assert cli.main(["demo", "--model", str(run.folder), "--port", str(port), *arguments]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"viewnet: {message.format(port=port)}")
    assert said.count("\n") == 1


def test_a_port_in_use_is_reported(run, capsys):
    pytest.importorskip("gradio")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert cli.main(["demo", "--model", str(run.folder), "--port", str(port)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"viewnet: 127.0.0.1:{port}: cannot listen there (")
    assert "--port" in said


def test_by_default_the_page_is_served_to_this_machine_only():
    options = cli.parser().parse_args(["demo", "--model", "x"])
    assert (options.host, options.port, options.share, options.open) == ("127.0.0.1", 7860, "no", False)


def test_help_has_examples(capsys):
    with pytest.raises(SystemExit):
        cli.main(["demo", "--help"])
    assert "examples:\n  viewnet demo " in capsys.readouterr().out
