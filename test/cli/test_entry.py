import shlex
import subprocess
import sys

import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

import odak
from odak.cli import app, main


def test_module_runs_in_its_own_process_help_needs_no_torch():
    code = (
        "import runpy, sys\n"
        "from odak.cli import main\n"
        "assert main(['--help']) == 0 and main(['hologram', '--help']) == 0\n"
        "assert not {'torch', 'scipy', 'plotly'} & set(sys.modules), sorted(sys.modules)\n"
        "sys.argv = ['odak', 'paint']\n"
        "runpy.run_module('odak', run_name='__main__', alter_sys=True)\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert result.returncode == 2 and "hologram" in result.stdout, result.stderr
    assert result.stderr.startswith("odak: ") and "paint" in result.stderr and result.stderr.count("\n") == 1


def test_help_lists_the_commands_with_whole_sentences():
    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80"}).stdout
    listed = text.partition("Commands:\n")[2].strip().splitlines()
    assert [line.split()[0] for line in listed][::14] == ["hologram", "info"]
    assert all(line.endswith(".") and not line.endswith("...") for line in listed)


@pytest.mark.parametrize("name", [command.name for command in app.registered_commands if command.name])
def test_help_ends_with_two_examples_that_the_command_takes(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "120"}).stdout
    lines = text.partition("Examples:\n")[2].strip().splitlines()
    assert len(lines) == 2
    for line in lines:
        program, command, *arguments = shlex.split(line)
        assert (program, command) == ("odak", name)
        context = typer.main.get_command(app).commands[name].make_context(name, arguments)
        assert not context.args and context.params


def test_help_states_units_and_defaults():
    text = " ".join(CliRunner().invoke(app, ["hologram", "--help"]).stdout.split())
    for part in (
        "(8um,6.4um). [default: (8um)]",
        "[default: 1080, 1920]",
        "638nm",
        "[default: (sgd; multiplane for more than one plane)]",
        "radians",
        "1 to 16",
    ):
        assert part in text


def test_info_names_versions_and_devices():
    result = CliRunner().invoke(app, ["info"])
    assert result.exit_code == 0
    rows = dict(line.split(maxsplit=1) for line in result.stdout.splitlines())
    assert rows["odak"] == odak.__version__
    assert rows["python"] == sys.version.split()[0]
    assert {"numpy", "scipy", "torch", "pillow", "plotly", "threads", "fft"} <= set(rows)
    assert "cpu" in rows["devices"]


def test_version_and_bare_call(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == odak.__version__
    assert main([]) == 0
    assert "hologram" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["--resolution", "48x32"], ["--resolution=48x32"], ["--resolution", "32", "48"]])
def test_a_resolution_in_one_word_is_width_by_height(words, tmp_path):
    given = [
        "--distance",
        "2mm",
        "--iterations",
        "1",
        "--device",
        "cpu",
        "--quiet",
        "--grey",
        "-o",
        str(tmp_path / "run"),
    ]
    assert main(["hologram", "photo", *words, *given]) == 0
    with Image.open(tmp_path / "run" / "hologram_532nm.png") as pattern:
        assert pattern.size == (48, 32)


def test_a_file_named_like_a_size_stays_a_file(capsys):
    assert main(["hologram", "48x32"]) == 2
    assert "48x32" in capsys.readouterr().err


def test_unknown_commands_are_code_2(capsys):
    assert main(["paint"]) == 2
    assert "paint" in capsys.readouterr().err


def test_unexpected_failures_are_not_hidden(monkeypatch, tmp_path):
    from odak.cli import hologram as module

    def broken(job, _):
        raise RuntimeError("a bug, tasks that allocate nothing")

    monkeypatch.setattr(module, "run", broken)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RuntimeError, match="a bug"):
        main(["hologram"])
    assert CliRunner().invoke(app, ["hologram"]).exit_code == 1


def test_lack_of_memory_is_told_in_a_line(monkeypatch, tmp_path, capsys):
    """PyTorch reports it as RuntimeError, whose text this is."""

    def fail(*_):
        raise RuntimeError("[enforce fail at alloc_cpu.cpp] DefaultCPUAllocator: can't allocate memory")

    monkeypatch.setattr("odak.cli.hologram.run", fail)
    assert main(["hologram", "--output", str(tmp_path)]) == 1
    assert capsys.readouterr().err.startswith("odak: not enough memory")
