import os
import pathlib
import stat
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from processes import is_running, wait_for

from odak.tools import file as files
from odak.tools import paths


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("files")


class TestPaths:
    @pytest.mark.parametrize("name", ["a.txt", "ünïcode ✓", "with space", "a..b", "...", "", "deep/er", "x/"])
    def test_ordinary_names_become_absolute(self, name, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        assert files.validate_path(name) == os.path.abspath(os.path.join(str(tmp_path), name))

    def test_home_objects_and_trailing_slash(self, tmp_path):
        assert files.validate_path("~/x") == os.path.join(os.path.expanduser("~"), "x")
        assert files.validate_path(pathlib.Path(tmp_path)) == str(tmp_path)
        assert files.validate_path(f"{tmp_path}/") == str(tmp_path)
        assert files.expanduser("~/x") == os.path.expanduser("~/x")

    @pytest.mark.parametrize(
        "path, reason",
        [
            ("../../etc/passwd", "Path traversal"),
            ("valid/../../../etc/passwd", "Path traversal"),
            ("a\\..\\b", "Path traversal"),
            ("test.txt\0.exe", "Null bytes"),
            ("http://a", "URL protocols"),
            ("x/HTTPS://a", "URL protocols"),
            ("ftp://a", "URL protocols"),
            ("file:///etc/passwd", "URL protocols"),
            ("//./device", "not allowed"),
            ("\\\\server\\share", "not allowed"),
            ("a" * 300, "exceeds maximum"),
        ],
    )
    def test_refused(self, path, reason):
        with pytest.raises(ValueError, match=reason):
            files.validate_path(path)

    def test_extensions(self):
        for allowed in ([".txt"], ["txt"], ["TXT"], (".png", ".TXT")):
            assert files.validate_path("a.Txt", allowed).endswith("a.Txt")
        for name in ("Makefile", "a.txt.exe", ".txt"):
            with pytest.raises(ValueError, match=r"not allowed .*accepted: \.txt"):
                files.validate_path(name, [".txt"])

    def test_working_folder(self):
        assert files.validate_cwd("~/test") == os.path.join(os.path.expanduser("~"), "test")
        assert files.validate_cwd("..") == os.path.dirname(os.getcwd())
        with pytest.raises(ValueError, match="Null bytes"):
            files.validate_cwd("a\0")
        with pytest.raises(TypeError, match="cwd must be a string"):
            files.validate_cwd(3)

    @pytest.mark.parametrize(
        "path, parts",
        [
            ("/p/file.txt", ("file", ".txt")),
            ("b.tar.gz", ("b.tar", ".gz")),
            ("noext", ("noext", "")),
            ("/p/", ("", "")),
            (".hidden", (".hidden", "")),
            ("file@#%.txt", ("file@#%", ".txt")),
        ],
    )
    def test_base_names(self, path, parts):
        assert files.get_base_filename(path) == parts


class TestCommands:
    def test_known_and_unknown_programs_pass(self, logged):
        command = ["blender", "-b", "scene.blend"]
        result = files.validate_shell_command(command)
        assert result == command
        assert result is not command
        files.validate_shell_command(["custom_tool", "--help"])
        files.validate_shell_command(["/opt/strange"])
        # The log of odak alone: threads of other packages, which earlier tests started, may write to theirs.
        said = [record.args[0] for record in logged.records if record.name.startswith("odak")]
        assert said == ["custom_tool", "/opt/strange"]

    @pytest.mark.parametrize("character", [";", "|", "&", "`", "$(", "${", ">", "<", "'", '"'])
    def test_shell_characters(self, character):
        with pytest.raises(ValueError, match="Dangerous character"):
            files.validate_shell_command(["python3", f"a{character}b"])

    @pytest.mark.parametrize(
        "command, kind, reason",
        [
            ("python3", TypeError, "must be a list"),
            (["python3", 123], TypeError, "must be a string"),
            (["python3", None], TypeError, "must be a string"),
            ([], ValueError, "cannot be empty"),
            (["python3", "a\0"], ValueError, "Null bytes"),
            (["python3", "a\nb"], ValueError, "Control character"),
        ],
    )
    def test_refused(self, command, kind, reason):
        with pytest.raises(kind, match=reason):
            files.validate_shell_command(command)

    def test_output_of_both_streams(self, tmp_path):
        script = tmp_path / "script.py"
        script.write_text("import os, sys; print(os.getcwd()); sys.stderr.write('bad')")
        process, out, err = files.shell_command([sys.executable, str(script)], cwd=str(tmp_path), timeout=30)
        assert (process.returncode, out.strip().decode(), err) == (0, str(tmp_path), b"bad")

    def test_at_once_without_check(self, tmp_path):
        script = tmp_path / "script.py"
        script.write_text("print('x' * 1_000_000)")
        process, out, err = files.shell_command([sys.executable, str(script)], cwd="~", check=False)
        assert (out, err) == (None, None)
        assert process.wait(timeout=30) == 0

    def test_timeout_kills_the_children_too(self, tmp_path):
        script = tmp_path / "script.py"
        script.write_text(
            "import subprocess, sys, time\n"
            "child = subprocess.Popen(['sleep', '3600'])\n"
            "print(child.pid, flush=True)\ntime.sleep(3600)\n"
        )
        # The program may take longer than the first limits to start its child.
        for timeout in (0.5, 5, 60):
            process, out, _ = files.shell_command([sys.executable, str(script)], timeout=timeout)
            assert process.returncode == -9
            if out:
                break
        wait_for(lambda: not is_running(int(out)))

    def test_missing_program_or_folder(self, tmp_path):
        with pytest.raises(FileNotFoundError):
            files.shell_command(["no_such_program_here"])
        with pytest.raises(FileNotFoundError):
            files.shell_command([sys.executable, "--version"], cwd=str(tmp_path / "none"))
        with pytest.raises(TypeError, match="cwd"):
            files.shell_command([sys.executable, "--version"], cwd=3)

    def test_an_interrupt_ends_the_process(self, monkeypatch):
        started = []
        original = subprocess.Popen.communicate

        def communicate(self, *args, **kwargs):
            started.append(self)
            if len(started) == 1:
                raise KeyboardInterrupt
            return original(self, *args, **kwargs)

        monkeypatch.setattr(subprocess.Popen, "communicate", communicate)
        with pytest.raises(KeyboardInterrupt):
            files.shell_command(["sleep", "60"])
        assert started[0].returncode == -9


class TestFolders:
    def test_made_once(self, tmp_path, monkeypatch):
        assert files.check_directory(tmp_path / "a" / "b") is False
        assert files.check_directory(f"{tmp_path}/a/b") is True
        monkeypatch.chdir(tmp_path / "a")
        assert files.check_directory("../c", validate=False) is False
        assert (tmp_path / "c").is_dir()
        with pytest.raises(ValueError, match="Path traversal"):
            files.check_directory("../d")

    def test_refused(self, tmp_path):
        (tmp_path / "file").write_text("")
        with pytest.raises(ValueError, match="is not a directory"):
            files.check_directory(tmp_path / "file")
        with pytest.raises(ValueError, match="cannot be made"):
            files.check_directory(tmp_path / "file" / "below")
        for validate in (True, False):
            with pytest.raises(TypeError, match="must be a string"):
                files.check_directory(3, validate=validate)

    def test_listing(self, tmp_path):
        for name in ("b.txt", "a.txt", "sub/c.txt", "sub/deep/d.png"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text("")
        (tmp_path / "folder.txt").mkdir()
        (tmp_path / "sub" / "loop").symlink_to(tmp_path)
        assert files.list_files(tmp_path, "*.txt", recursive=False) == [str(tmp_path / n) for n in ("a.txt", "b.txt")]
        assert [os.path.basename(name) for name in files.list_files(tmp_path)] == ["a.txt", "b.txt", "c.txt", "d.png"]
        assert files.list_files(tmp_path / "none") == []
        assert files.list_directories(tmp_path, recursive=False) == ["folder.txt", "sub"]
        assert files.list_directories(tmp_path) == ["deep", "folder.txt", "loop", "sub"]
        with pytest.raises(FileNotFoundError, match="none"):
            files.list_directories(tmp_path / "none")

    @pytest.mark.parametrize("key", ["../*", "/etc/*", "", "a/../../*"])
    def test_patterns_stay_below(self, tmp_path, key):
        with pytest.raises(ValueError, match="key must be a pattern"):
            files.list_files(tmp_path, key)

    def test_sizes(self, tmp_path):
        assert files.convert_bytes(512) == (512, "bytes")
        assert isinstance(files.convert_bytes(512)[0], int)
        assert files.convert_bytes(1024) == (1.0, "KB")
        assert files.convert_bytes(3 * 1024**4) == (3.0, "TB")
        assert files.convert_bytes(5 * 1024**5) == (5.0, "PB")
        assert files.convert_bytes(4096 * 1024**6) == (4096.0, "EB")
        (tmp_path / "a").write_bytes(bytes(1536))
        assert files.size_of_a_file(tmp_path / "a") == (1.5, "KB")
        assert files.size_of_a_file(tmp_path / "none") == (None, None)
        assert files.size_of_a_file(tmp_path) == (None, None)


class TestCopies:
    def test_content_times_and_overwriting(self, tmp_path):
        source, copy = tmp_path / "a", tmp_path / "b"
        source.write_text("new")
        copy.write_text("old and longer")
        os.utime(source, (1_000_000, 2_000_000))
        assert files.copy_file(source, copy) == str(copy)
        assert copy.stat().st_atime == source.stat().st_atime
        assert copy.stat().st_mtime == 2_000_000
        assert copy.read_text() == "new"

    def test_links(self, tmp_path):
        (tmp_path / "a").write_text("text")
        (tmp_path / "link").symlink_to(tmp_path / "a")
        files.copy_file(tmp_path / "link", tmp_path / "content")
        files.copy_file(tmp_path / "link", tmp_path / "copy", follow_symlinks=False)
        assert not (tmp_path / "content").is_symlink()
        assert (tmp_path / "copy").is_symlink()
        assert (tmp_path / "content").read_text() == (tmp_path / "copy").read_text() == "text"

    @pytest.mark.parametrize(
        "source, destination, reason",
        [
            ("none", "b", "Source file does not exist"),
            ("folder", "b", "Source is not a file"),
            ("a", "folder", "Destination is a directory"),
            ("a", "a", "the same file"),
            ("a", "none/b", "does not exist"),
        ],
    )
    def test_refused(self, tmp_path, source, destination, reason):
        (tmp_path / "a").write_text("text")
        (tmp_path / "folder").mkdir()
        with pytest.raises(ValueError, match=reason):
            files.copy_file(tmp_path / source, tmp_path / destination)
        assert (tmp_path / "a").read_text() == "text"

    def test_a_failure_leaves_the_old_copy(self, tmp_path, monkeypatch):
        (tmp_path / "a").write_text("new")
        (tmp_path / "b").write_text("old")

        def fail(source, target, **kwargs):
            pathlib.Path(target).write_text("ha")
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("shutil.copy2", fail)
        with pytest.raises(ValueError, match="No space left"):
            files.copy_file(tmp_path / "a", tmp_path / "b")
        assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a", "b"]
        assert (tmp_path / "b").read_text() == "old"


class TestAtomicFiles:
    def test_rights_of_new_and_old_files(self, tmp_path):
        path = str(tmp_path / "a")
        with paths.replacing(path) as stream:
            stream.write(b"1")
        pathlib.Path(tmp_path / "plain").write_text("")
        assert os.stat(path).st_mode == os.stat(tmp_path / "plain").st_mode
        os.chmod(path, 0o640)
        with paths.replacing(path) as stream:
            stream.write(b"2")
        assert stat.S_IMODE(os.stat(path).st_mode) == 0o640
        assert pathlib.Path(path).read_bytes() == b"2"

    def test_links_are_followed(self, tmp_path):
        (tmp_path / "a").write_text("1")
        (tmp_path / "link").symlink_to("a")
        with paths.replacing(str(tmp_path / "link")) as stream:
            stream.write(b"2")
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "a").read_text() == "2"

    @pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
    def test_any_failure_leaves_nothing_behind(self, tmp_path, error):
        (tmp_path / "a").write_text("old")
        with pytest.raises(error), paths.replacing(str(tmp_path / "a")) as stream:
            stream.write(b"new")
            raise error
        assert [entry.read_text() for entry in tmp_path.iterdir()] == ["old"]

    def test_devices_are_not_replaced(self):
        with pytest.raises(ValueError, match="'/dev/null' is not a file"), paths.replacing("/dev/null"):
            pass
        assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=4,
)


class TestDocuments:
    @settings(max_examples=20)
    @given(st.dictionaries(st.text(max_size=5), json_values, max_size=4))
    def test_dictionaries_come_back(self, folder, settings):
        path = folder / "settings.json"
        assert files.save_dictionary(settings, path) is settings
        assert files.load_dictionary(path) == settings

    def test_layout(self, tmp_path):
        files.save_dictionary({"λ": [1]}, tmp_path / "a.json")
        assert (tmp_path / "a.json").read_bytes() == '{\n    "λ": [\n        1\n    ]\n}'.encode()

    def test_numbers_arrays_and_tensors_are_written_as_json_has_them(self, tmp_path):
        held = {
            "count": np.int64(3),
            "dx": np.float32(0.5),
            "on": np.bool_(True),
            "points": np.arange(4.0).reshape(2, 2),
            "phase": torch.tensor([1.5, 2.0], requires_grad=True),
            "scale": torch.tensor(2),
            "folder": pathlib.PurePosixPath("a/b"),
        }
        files.save_dictionary(held, tmp_path / "a.json")
        assert files.load_dictionary(tmp_path / "a.json") == {
            "count": 3, "dx": 0.5, "on": True, "points": [[0.0, 1.0], [2.0, 3.0]], "phase": [1.5, 2.0], "scale": 2,
            "folder": "a/b",
        }  # fmt: skip
        with pytest.raises(TypeError, match="JSON"):
            files.save_dictionary({"field": np.ones(2) * 1j}, tmp_path / "a.json")

    def test_what_json_lacks_is_found_before_the_file_is_touched(self, tmp_path):
        files.save_dictionary({"a": 1}, tmp_path / "a.json")
        for value in (1j, {1, 2}, object()):
            with pytest.raises(TypeError, match="JSON"):
                files.save_dictionary({"a": 2, "b": value}, tmp_path / "a.json")
        assert files.load_dictionary(tmp_path / "a.json") == {"a": 1}

    @pytest.mark.parametrize("name", ["experiment.txt", "experiment", "lab.settings", "a.JSON"])
    def test_settings_have_any_name(self, tmp_path, name):
        settings = {"slm": {"pitch": 8e-6, "resolution": [1080, 1920]}}
        (tmp_path / name).write_text('{"slm": {"pitch": 8e-6, "resolution": [1080, 1920]}}')
        assert files.load_dictionary(str(tmp_path / name)) == settings
        files.save_dictionary({"other": settings}, tmp_path / name)
        assert files.load_dictionary(tmp_path / name) == {"other": settings}

    def test_refused(self, tmp_path):
        with pytest.raises(ValueError, match=r"Folder .*none' does not exist"):
            files.save_dictionary({}, tmp_path / "none" / "a.json")
        with pytest.raises(FileNotFoundError, match=r"none\.json"):
            files.load_dictionary(tmp_path / "none.json")
        for content in (b"", b'{"a": 1', b"\xff\xfe\x00", b"[" * 100_000):
            (tmp_path / "bad.json").write_bytes(content)
            with pytest.raises(ValueError, match=r"bad\.json' is not a JSON file"):
                files.load_dictionary(tmp_path / "bad.json")

    def test_lines(self, tmp_path):
        path = tmp_path / "a.txt"
        assert files.write_to_text_file(["one ", 2, "drei é"], path) is True
        assert path.read_bytes() == "one \n2\ndrei é\n".encode()
        assert files.read_text_file(path) == ["one", "2", "drei é"]
        files.write_to_text_file("a string", path, write_flag="a")
        assert files.read_text_file(path)[-1] == "a string"
        files.write_to_text_file(["X"], path, "r+")
        assert path.read_text(encoding="utf-8").startswith("X\ne \n2")
        files.write_to_text_file([], path, "w+")
        assert path.read_bytes() == b""

    def test_flags_and_missing_files(self, tmp_path):
        path = tmp_path / "a.txt"
        for flag in ("r", "wb", "q"):
            with pytest.raises(ValueError, match="write_flag must be one of"):
                files.write_to_text_file(["x"], path, flag)
        with pytest.raises(FileNotFoundError):
            files.write_to_text_file(["x"], path, "r+")
        files.write_to_text_file(["x"], path, "x")
        with pytest.raises(FileExistsError):
            files.write_to_text_file(["x"], path, "x")
        for flag in ("w", "a"):
            with pytest.raises(ValueError, match="does not exist"):
                files.write_to_text_file(["x"], tmp_path / "none" / "a.txt", flag)
        with pytest.raises(FileNotFoundError):
            files.read_text_file(tmp_path / "none.txt")
        path.write_bytes(b"\xff\xff")
        with pytest.raises(ValueError, match=r"a\.txt' is not a UTF-8 text file"):
            files.read_text_file(path)
