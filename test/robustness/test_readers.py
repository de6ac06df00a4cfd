"""Files from elsewhere, broken and hostile: read, or refused by name, within a time, a memory and a folder."""

import contextlib
import gc
import io
import os
import pickle
import random
import re
import struct
import subprocess
import sys
import threading
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
import structure
import torch
from PIL import Image
from processes import LIMIT

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
pytest.importorskip("resource", reason="memory and time are watched by Unix means")
if not os.path.exists("/proc/self/clear_refs"):
    pytest.skip("the peak of memory is read from Linux' /proc", allow_module_level=True)

import matplotlib  # noqa: E402

from fuzz import archive_seeds, guard, mutations  # noqa: E402
from fuzz.readers import READERS  # noqa: E402
from odak import tools  # noqa: E402
from odak.learn.tools import save_torch_tensor, torch_load  # noqa: E402
from odak.tools.asset import read_PLY_point_cloud  # noqa: E402

CORPUS = Path(__file__).parent / "corpus"
FILES = sorted(path.relative_to(CORPUS) for path in CORPUS.glob("*/*"))
CASES = 25
# Matplotlib makes its folders when it is first used, wherever that is.
matplotlib.get_configdir()
matplotlib.get_cachedir()


@pytest.fixture(autouse=True, scope="module")
def nothing_left_behind():
    """Free what tests of other modules left behind, which may remove its files then: not while a reader is watched."""
    gc.collect()


@pytest.fixture(autouse=True)
def one_thread():
    """Compute on one thread: small work on several threads waits for them more than it computes."""
    count = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(count)


def judged(name, folder, extension, content):
    """Return the violation that a reader committed, or None, and whether it read the file."""
    if name in ("calibration", "captures"):
        pytest.importorskip("h5py", reason="h5py is not installed")
    path = folder / f"case{extension}"
    path.write_bytes(content)
    reader = READERS[name]
    names = (path.name, "case.") if reader.named else ()
    return guard.breach(lambda: reader.call(str(path)), str(folder), names, reader.megabytes, reader.seconds)


def test_the_corpus_is_small_and_has_every_reader():
    assert {path.parts[0] for path in FILES} == set(READERS)
    sizes = [(CORPUS / path).stat().st_size for path in FILES]
    assert max(sizes) < 20_000 and sum(sizes) < 300_000


# Readers of files that are not broken here one by one, with the reason.
OF_OTHERS = {
    "load_colmap": "reads a folder of several files",
    "load_materials": "reads files by read_materials",
    "load_voxelized_PLY": "reads files by read_PLY",
}


def test_each_public_reader_is_in_the_list():
    public = {name for names in structure.stubs().values() for name in names if re.match("(read|load)_", name)}
    calls = "".join((ROOT / "fuzz" / name).read_text(encoding="utf-8") for name in ("readers.py", "archive_seeds.py"))
    assert {name for name in public if not re.search(rf"\b{name}\b", calls)} == set(OF_OTHERS)


def test_named_pipes_are_refused_and_not_waited_for(tmp_path):
    """A reader that opened a pipe would wait for a writer; the test writes to it then, and fails."""
    waited = []
    for name in [name for name in READERS if name not in ("command", "line", "checkpoint", "scene")]:
        for extension in {path.suffix for path in FILES if path.parts[0] == name}:
            pipe = tmp_path / f"{name}{extension}"
            os.mkfifo(pipe)
            call = threading.Thread(target=refused, args=(READERS[name].call, str(pipe)), daemon=True)
            call.start()
            call.join(LIMIT)
            if call.is_alive():
                waited.append(pipe.name)
                os.close(os.open(pipe, os.O_RDWR))
    assert not waited


def refused(call, path):
    with contextlib.suppress(ValueError, TypeError, OSError, ImportError):
        call(path)


# Lines of commands trace lenses and compute holograms: test/cli holds them in the default run.
@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n == "line" else n for n in READERS])
def test_files_found_once_are_read_or_refused_by_name(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    held = [path for path in FILES if path.parts[0] == name]
    read = 0
    # The first call imports what it needs, which takes memory.
    judged(name, tmp_path, held[0].suffix, (CORPUS / held[0]).read_bytes())
    for path in held:
        found, was_read = judged(name, tmp_path, path.suffix, (CORPUS / path).read_bytes())
        assert found is None, f"{path}: {found}"
        read += was_read
    assert read > 0 and not (tmp_path / "pwned").exists()


@pytest.mark.parametrize("name", [name for name in READERS if name not in ("line", "scene")])
def test_random_files_are_read_or_refused_by_name(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    reader, chance = READERS[name], random.Random(7)
    seeds = [(path.suffix, (CORPUS / path).read_bytes()) for path in FILES if path.parts[0] == name]
    contents = [content for _, content in seeds]
    judged(name, tmp_path, *seeds[0])
    for number in range(CASES):
        extension, content = chance.choice(seeds)
        broken = mutations.mutate(content, chance, contents, reader.tokens, reader.structure)
        found, _ = judged(name, tmp_path, extension, broken)
        if found is not None:
            pytest.fail(f"case {number}: {found}; {broken[:200]!r}")


def loop_for_ever():
    while True:
        pass


@pytest.mark.parametrize(
    ("misdeed", "told"),
    [
        (lambda folder: {}["x"], "raised KeyError"),
        (lambda folder: (folder.parent / "out").write_text(""), "open outside its folder"),
        (lambda folder: os.system("true"), "started a program"),
        (lambda folder: bytearray(256 << 20), "MB of memory"),
        (lambda folder: loop_for_ever(), "processor time"),
        (lambda folder: int("x"), "without naming the file"),
        (lambda folder: sys.exit(0), "raised SystemExit"),
    ],
)
@pytest.mark.slow
def test_the_guard_sees_every_misdeed(misdeed, told, tmp_path):
    folder = tmp_path / "inside"
    folder.mkdir()
    # What earlier tests left behind must not be freed while memory is counted.
    gc.collect()
    # Taking the memory must not exceed the processor time, on any machine.
    seconds = 0.2 if told == "processor time" else 60
    found, _ = guard.breach(lambda: misdeed(folder), str(folder), ("case.",), megabytes=32, seconds=seconds)
    assert told in found


def test_guard_tells_threads_of_the_reader_from_earlier_ones(tmp_path):
    outside, inside, begin, done = tmp_path / "out", tmp_path / "inside", threading.Event(), threading.Event()
    inside.mkdir()

    def write():
        begin.wait()
        outside.write_text("")
        done.set()

    def wait_for_other():
        begin.set()
        assert done.wait(60)

    def start_one():
        thread = threading.Thread(target=write)
        thread.start()
        thread.join()

    other = threading.Thread(target=write)
    other.start()
    assert guard.breach(wait_for_other, str(inside), ("case.",)) == (None, True)
    other.join()
    found, _ = guard.breach(start_one, str(inside), ("case.",))
    assert "open outside its folder" in found


def test_the_guard_lets_modules_be_imported(tmp_path, monkeypatch):
    (tmp_path / "imported_meanwhile.py").write_text("")
    (tmp_path / "inside").mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))
    found = guard.breach(lambda: __import__("imported_meanwhile"), str(tmp_path / "inside"), ())
    del sys.modules["imported_meanwhile"]
    assert found == (None, True)


def test_the_guard_lets_pass_what_is_allowed(tmp_path):
    def call():
        (tmp_path / "x").write_text("")
        raise ValueError("case.x is broken")

    assert guard.breach(call, str(tmp_path), ("case.",)) == (None, False)


class TestPly:
    HEADER = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    FACES = "element face {}\nproperty list uchar int vertex_indices\n"

    @pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
    @pytest.mark.parametrize("counts", [(10**9, 1), (3, 4 * 10**9), (10**30, 1), (-1, 1)])
    def test_headers_that_declare_more_than_the_file_are_refused(self, form, counts, tmp_path):
        text = self.HEADER.format(form, counts[0]) + self.FACES.format(counts[1]) + "end_header\n"
        found, read = judged("ply", tmp_path, ".ply", text.encode() + bytes(60))
        assert (found, read) == (None, False)
        with pytest.raises(ValueError, match=r"case\.ply' cannot be read .* promises at least"):
            tools.read_PLY(tmp_path / "case.ply")

    def test_an_element_without_properties_takes_no_time(self, tmp_path):
        text = self.HEADER.format("ascii", 1) + "element nothing 1000000000\nend_header\n1 2 3\n"
        assert judged("ply", tmp_path, ".ply", text.encode()) == (None, False)

    def test_a_header_without_end(self, tmp_path):
        (tmp_path / "a.ply").write_text("ply\nformat ascii 1.0\n" + "comment x\n" * 10_000)
        with pytest.raises(ValueError, match="header does not end"):
            read_PLY_point_cloud(tmp_path / "a.ply")

    @pytest.mark.parametrize("newline", ["\n", "\r", "\r\n"])
    def test_headers_that_declare_exactly_the_file_are_read(self, newline, tmp_path):
        header = self.HEADER.format("binary_little_endian", 2) + "end_header\n"
        points = np.arange(6, dtype="<f4")
        (tmp_path / "a.ply").write_bytes(header.replace("\n", newline).encode() + points.tobytes())
        np.testing.assert_array_equal(read_PLY_point_cloud(tmp_path / "a.ply"), points.reshape(2, 3))
        (tmp_path / "b.ply").write_bytes(header.replace("\n", newline).encode() + points.tobytes()[:-1])
        with pytest.raises(ValueError, match=r"b\.ply"):
            read_PLY_point_cloud(tmp_path / "b.ply")


class TestImages:
    @staticmethod
    def png(width, height, content=b""):
        def chunk(kind, content):
            return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

        header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
        return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", content) + chunk(b"IEND", b"")

    @pytest.mark.parametrize("size", [(13_000, 13_000), (5000, 4000), (100_000, 100_000), (2**31 - 1, 2**31 - 1)])
    def test_bombs_are_refused_before_memory_is_taken(self, size, tmp_path):
        (tmp_path / "case.png").write_bytes(self.png(*size, zlib.compress(bytes(1000))))
        found, read = guard.breach(lambda: tools.load_image(tmp_path / "case.png"), str(tmp_path), ("case.png",), 32)
        assert (found, read) == (None, False)

    def test_a_webp_of_one_colour_is_refused(self, tmp_path):
        stream = io.BytesIO()
        Image.new("RGB", (6000, 5000)).save(stream, "WEBP", lossless=True)
        (tmp_path / "case.webp").write_bytes(stream.getvalue())
        with pytest.raises(ValueError, match=r"case\.webp': 6000 x 5000 pixels in \d+ bytes are more than"):
            tools.load_image(tmp_path / "case.webp")

    def test_large_pictures_in_large_files_are_believed(self, tmp_path, monkeypatch):
        from odak.tools import file

        monkeypatch.setattr(file, "FREE_PIXELS", 100)
        tools.save_image(tmp_path / "a.png", np.full((200, 200), 77.0))
        assert (tools.load_image(tmp_path / "a.png") == 77).all()

    def test_an_inset_starts_no_program(self, tmp_path):
        from odak.visualize.plotly import field_figures

        path = tmp_path / "case.png"
        path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nshowpage\n%%EOF\n")
        assert guard.breach(lambda: field_figures._inset(path), str(tmp_path), ("case.png",)) == (None, False)
        deep = np.arange(12.0).reshape(3, 4) * 5000
        tools.save_image(path, deep, 0, 65535, color_depth=16)
        found = field_figures._inset(path)
        assert found.mode == "RGBA" and found.getpixel((3, 2)) == (214, 214, 214, 255)


class TestTorchFiles:
    @staticmethod
    def archive(path, records, compression=zipfile.ZIP_STORED):
        with zipfile.ZipFile(path, "w", compression) as archive:
            for name, content in records:
                archive.writestr(name, content)

    @staticmethod
    def records(path):
        with zipfile.ZipFile(path) as archive:
            return [(name, archive.read(name)) for name in archive.namelist()]

    @pytest.mark.parametrize("order", [b"little", b"big"])
    def test_a_tensor_longer_than_its_bytes_is_refused(self, order, tmp_path):
        path = tmp_path / "a.pt"
        torch.save(torch.arange(4.0), path)
        # BININT1 4, the number of elements and then the size, become BININT 40 000 000.
        large = b"J" + struct.pack("<i", 40_000_000)
        longer = [
            (name, content.replace(b"K\x04", large) if name.endswith("data.pkl") else content)
            for name, content in self.records(path)
        ]
        self.archive(path, [(name, order if name.endswith("byteorder") else content) for name, content in longer])
        with pytest.raises(ValueError, match=r"Failed to load .*a\.pt'"):
            torch_load(path)

    def test_compressed_archives_are_refused(self, tmp_path):
        path = tmp_path / "a.pt"
        torch.save(torch.zeros(10_000_000), path)
        self.archive(path, self.records(path), zipfile.ZIP_DEFLATED)
        assert path.stat().st_size < 100_000
        with pytest.raises(ValueError, match=r"a\.pt': its records are compressed"):
            torch_load(path)

    @pytest.mark.parametrize("legacy", [False, True])
    def test_numbers_do_not_become_bytes(self, legacy, tmp_path):
        held = pickle.dumps(archive_seeds.Payload(bytearray, 10**9), 2)
        if legacy:
            (tmp_path / "case.pt").write_bytes(held)
        else:
            self.archive(tmp_path / "case.pt", [("a/data.pkl", held), ("a/version", b"3\n")])
        found, read = guard.breach(lambda: torch_load(tmp_path / "case.pt"), str(tmp_path), ("case.pt",), 64)
        assert (found, read) == (None, False)

    def test_indices_stay_within_a_sparse_tensor(self, tmp_path):
        path, values = tmp_path / "a.pt", torch.tensor([1.0, 2.0])
        torch.save(torch.sparse_coo_tensor(torch.tensor([[0, 2]]), values, (3,), check_invariants=True), path)
        assert torch_load(path).to_dense().tolist() == [1, 0, 2]
        torch.save([torch.sparse_coo_tensor(torch.tensor([[0, 5]]), values, (3,), check_invariants=False)], path)
        with pytest.raises(ValueError, match=r"a\.pt': .*index 5"):
            torch_load(path)

    @pytest.mark.filterwarnings("ignore:.*(nested tensors|quantize_per_tensor|TypedStorage).*:UserWarning")
    def test_tensors_that_torch_does_not_check_are_refused(self, tmp_path):
        nested = torch.nested.nested_tensor([torch.ones(2), torch.ones(3)])
        quantized = torch.quantize_per_tensor(torch.ones(3), 0.1, 0, torch.quint8)
        for odd in (nested, quantized):
            torch.save({"a": [odd]}, tmp_path / "a.pt")
            with pytest.raises(ValueError, match=r"a\.pt': it contains a nested or a quantized tensor"):
                torch_load(tmp_path / "a.pt")
        with pytest.raises(ValueError, match=r"find04\.pt': it contains a tensor of shape \[-2147483648, 0\]"):
            torch_load(CORPUS / "tensor" / "find04.pt")

    def test_shared_lists_are_walked_once(self, tmp_path):
        shared = [torch.ones(1)]
        for _ in range(60):
            shared = [shared, shared]
        torch.save(shared, tmp_path / "a.pt")
        with pytest.raises(ValueError, match=r"a\.pt': its lists share one another"):
            torch_load(tmp_path / "a.pt")
        torch.save({"a": [[1.0] * 10] * 100, "b": {"c": (1, 2)}}, tmp_path / "a.pt")
        assert torch_load(tmp_path / "a.pt")["a"][99][9] == 1.0
        endless: list = []
        endless.append({"a": endless})
        torch.save(endless, tmp_path / "a.pt")
        with pytest.raises(ValueError, match=r"a\.pt': it contains a list that contains itself"):
            torch_load(tmp_path / "a.pt")
        deep: list = []
        for _ in range(100):
            deep = [deep]
        torch.save(deep, tmp_path / "a.pt")
        assert torch_load(tmp_path / "a.pt") == deep

    def test_tensors_longer_than_their_data_are_refused(self, tmp_path):
        path = tmp_path / "a.pt"
        wide = torch.ones(1).expand(10**12)
        values = torch.sparse_coo_tensor(torch.tensor([[0, 2]]), torch.ones(1).expand(2), (3,), check_invariants=True)
        for held, told in (
            ({"a": [wide]}, "longer than its data"),
            (torch.arange(9.0).as_strided((5, 5), (1, 1)), "longer than its data"),
            (values, "longer than its data"),
            ([torch.ones(3, device="meta")], "without data"),
        ):
            torch.save(held, path)
            with pytest.raises(ValueError, match=rf"a\.pt': it contains a tensor .*{told}"):
                torch_load(path)
        torch.save(torch.arange(12.0).reshape(3, 4).T[1:], path)
        assert torch_load(path, map_location="meta").is_meta
        assert torch_load(path).shape == (3, 3)

    def test_code_is_named_and_not_run(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        torch.save(archive_seeds.Payload(os.system, "touch pwned"), "a.pt")
        with pytest.raises(ValueError, match=r"a\.pt': it calls for posix\.system") as caught:
            torch_load("a.pt")
        assert isinstance(caught.value, pickle.UnpicklingError)
        assert os.listdir() == ["a.pt"]

    @pytest.mark.parametrize("legacy", [False, True])
    def test_tensors_do_not_hang_on_the_file(self, legacy, tmp_path):
        path, shared = tmp_path / "a.pt", torch.arange(5.0)
        held = {"a": shared, "b": shared[1:], "c": torch.ones(2, dtype=torch.complex64), "d": torch.empty(0)}
        torch.save(held, path, _use_new_zipfile_serialization=not legacy)
        for device in (None, "cpu"):
            found = torch_load(path, map_location=device)
            assert all(torch.equal(found[name], value) for name, value in held.items())
            found["a"][1] = 9
            assert found["b"][0] == 9
        found = torch_load(path)
        path.write_bytes(bytes(path.stat().st_size))
        assert all(torch.equal(found[name], value) for name, value in held.items())
        save_torch_tensor(path, found)
        assert torch.equal(torch_load(path)["b"], shared[1:])


class TestArrays:
    """Files of 2 to 800 kB that promise gigabytes, or take minutes."""

    @staticmethod
    def refused(path, told):
        from odak.instruments import load_calibration

        with pytest.raises(ValueError, match=told):
            load_calibration(path)
        found = guard.breach(lambda: load_calibration(path), str(path.parent), (path.name,), 32, 2.0)
        assert found == (None, False)

    @pytest.mark.parametrize(
        ("made", "told"),
        [
            (lambda store: {"shape": (20000, 20000), "dtype": "f8"}, "its arrays take 3200"),
            (lambda store: {"shape": (4000, 4000), "chunks": (1, 1), "dtype": "f8"}, "consists of 16000000 chunks"),
            (lambda store: {"shape": (4000, 4000), "chunks": (4000, 4000), "dtype": "f8"}, "chunks of more than"),
            (lambda store: {"data": np.eye(9), "compression": "lzf"}, "compressed more than once, or not by gzip"),
            (lambda store: [store.create_dataset(f"x{i}", data=1) for i in range(70)] and {"data": 1}, "74 arrays"),
            (lambda store: store.attrs.update({f"x{i}": 1 for i in range(300)}) or {"data": 1}, "attributes"),
            (lambda store: {"data": "words"}, "'amplitude' is not an array of numbers within the file"),
        ],
    )
    def test_hdf5(self, made, told, tmp_path):
        h5py = pytest.importorskip("h5py", reason="h5py is not installed")
        path = tmp_path / "case.h5"
        path.write_bytes((CORPUS / "calibration" / "seed00.h5").read_bytes())
        with h5py.File(path, "a") as store:
            del store["amplitude"]
            store.create_dataset("amplitude", **made(store))
        self.refused(path, told)

    def test_compression_within_compression(self, tmp_path):
        h5py = pytest.importorskip("h5py", reason="h5py is not installed")
        path = tmp_path / "case.h5"
        path.write_bytes((CORPUS / "calibration" / "seed00.h5").read_bytes())
        with h5py.File(path, "a") as store:
            del store["amplitude"]
            twice = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            twice.set_chunk((1000, 1000))
            twice.set_deflate(9)
            twice.set_filter(h5py.h5z.FILTER_DEFLATE, 0, (9,))
            space = h5py.h5s.create_simple((1000, 1000))
            h5py.h5d.create(store.id, b"amplitude", h5py.h5t.NATIVE_DOUBLE, space, twice)
        self.refused(path, "compressed more than once")

    def test_archives(self, tmp_path):
        path, header = tmp_path / "case.npz", io.BytesIO()
        declared = {"descr": "<f8", "fortran_order": False, "shape": (20_000_000_000,)}
        np.lib.format.write_array_header_1_0(header, declared)
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("header.npy", header.getvalue())
        self.refused(path, r"'header\.npy' is truncated: its header states \[20000000000\]")
        large = io.BytesIO()
        np.save(large, np.zeros(22_000_000))
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            archive.writestr("header.npy", large.getbuffer())
        assert path.stat().st_size < 1_000_000
        del large
        self.refused(path, "its records take 176000128 bytes; at most")


def test_a_scene_takes_no_arrays_of_another(tmp_path):
    from odak.visualize.blender import scene

    for name, side in (("a", 1.0), ("b", 2.0)):
        made = scene()
        made.add_mesh(np.eye(3) * side, [[0, 1, 2]])
        made.save(tmp_path / f"{name}.json")
    assert scene.load(tmp_path / "a.json").objects[0].vertices.max() == 1
    (tmp_path / "b.npz").replace(tmp_path / "a.npz")
    with pytest.raises(ValueError, match=r"a\.json' cannot be read as a scene: 'a\.npz' contains the arrays of"):
        scene.load(tmp_path / "a.json")


@pytest.mark.parametrize("name", ["../../x", "a\0b", "$(touch pwned)", "`touch pwned`", "|touch pwned", "http://x/y"])
def test_names_of_files_are_no_commands(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    readers = {
        ".png": tools.load_image, ".ply": tools.read_PLY, ".json": tools.load_dictionary, ".pt": torch_load,
        ".txt": tools.read_text_file,
    }  # fmt: skip
    for extension, read in readers.items():
        found, was_read = guard.breach(
            lambda read=read, end=extension: read(name + end), str(tmp_path), (name, repr(name)[1:-1])
        )
        assert (found, was_read) == (None, False), extension
    assert not list(tmp_path.rglob("*"))


@pytest.mark.slow
def test_the_command(tmp_path):
    command = [sys.executable, str(ROOT / "fuzz"), "text", "json", "--minutes", "0.03", "--finds", str(tmp_path)]
    # Some four seconds, and the start of three programs, which takes a slow machine far longer.
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(" 0 deaths, 0 kinds of finds") == 2
    done = subprocess.run([*command[:2], "nonsense"], capture_output=True, text=True, timeout=600)
    assert done.returncode == 2 and "no such reader: nonsense" in done.stderr
