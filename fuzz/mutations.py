"""Ways to break a file: of bytes, of numbers in a text, of lines, of JSON, of PNG chunks, of torch's archives."""

import contextlib
import io
import json
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence

NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"0", b"-1", b"1", b"1.5", b"-0.0", b"nan", b"-nan", b"inf", b"-inf", b"NaN", b"Infinity", b"-Infinity", b"1e308",
    b"1e309", b"-1e308", b"1e-320", b"255", b"256", b"65535", b"65536", b"2147483647", b"-2147483648", b"4294967296",
    b"1000000000", b"9223372036854775808", b"1" + b"0" * 400, b"0x10", b"1_000", b"1,5", "٣".encode(), b"",
)  # fmt: skip
TOKENS = (
    b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n", b"\r\n", b"\x0c", b"\x1a", b"\x85", "\u2028".encode(),
    b"\xed\xa0\x80", b"../../x", b"..\\..\\x", b"/etc/passwd", b"$(touch pwned)", b"`touch pwned`", b"|touch pwned",
    b"; touch pwned", b"%s%n", b"{0.__class__}", b"${HOME}", b"~", b"file:///etc/passwd", b"'", b'"', b"\\",
    b"!!python/object",
    b"__import__('os').system('touch pwned')", b"<!ENTITY", b"A" * 5000,
)  # fmt: skip
VALUES = (
    None, True, False, 0, -1, 1.5, 10**400, 2**63, 1e308, float("nan"), float("inf"), "", "x", "../../x", "$(id)",
    "a\0b", "\ud800", [], {}, [[]], [None], {"": None}, [1] * 300, "9" * 5000,
)  # fmt: skip
_WIDTHS = ("<H", ">H", "<I", ">I", "<Q")
_LONGEST = 4096


def mutate(
    data: bytes, chance: random.Random, seeds: Sequence[bytes], tokens: Sequence[bytes], structure: Callable | None
):
    """Return a broken copy of a file, after one to four changes.

    Parameters
    ----------
    data : bytes
        A valid file.
    chance : random.Random
        Source of the choices.
    seeds : sequence of bytes
        Other valid files, whose parts are put in.
    tokens : sequence of bytes
        Words of the format.
    structure : callable, optional
        ``structure(data, chance)`` changes it as a file of its format.

    Returns
    -------
    bytes
        At most 4096, or as long as the file was.
    """
    longest = max(_LONGEST, len(data))
    for _ in range(chance.choice((1, 1, 1, 2, 2, 3, 4))):
        if structure is not None and chance.random() < 0.5:
            data = structure(data, chance)
        else:
            data = chance.choice(_PLAIN)(data, chance, seeds, tokens)
    return data[:longest]


def _flip(data, chance, seeds, tokens):
    changed = bytearray(data)
    for _ in range(chance.randint(1, 8) if changed else 0):
        changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _set_bytes(data, chance, seeds, tokens):
    changed = bytearray(data)
    for _ in range(chance.randint(1, 4) if changed else 0):
        changed[chance.randrange(len(changed))] = chance.choice((0, 1, 9, 10, 32, 34, 45, 48, 57, 127, 128, 254, 255))
    return bytes(changed)


def _set_integer(data, chance, seeds, tokens):
    form = chance.choice(_WIDTHS)
    size = struct.calcsize(form)
    if len(data) < size:
        return data
    place = chance.randrange(min(len(data) - size + 1, chance.choice((64, 512, len(data)))))
    value = chance.choice((0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 10**9, 65535, 65536, 13000, 32768)) % 256**size
    return data[:place] + struct.pack(form, value) + data[place + size :]


def _truncate(data, chance, seeds, tokens):
    return data[: chance.randrange(len(data) + 1)]


def _remove(data, chance, seeds, tokens):
    start, size = _part(data, chance)
    return data[:start] + data[start + size :]


def _double(data, chance, seeds, tokens):
    start, size = _part(data, chance)
    return data[: start + size] + data[start : start + size] * chance.choice((1, 1, 2, 30)) + data[start + size :]


def _insert(data, chance, seeds, tokens):
    place = chance.randrange(len(data) + 1)
    return data[:place] + chance.choice((*tokens, *TOKENS, chance.randbytes(chance.randint(1, 16)))) + data[place:]


def _splice(data, chance, seeds, tokens):
    other = chance.choice(seeds)
    start, size = _part(other, chance)
    place, gone = _part(data, chance)
    return data[:place] + other[start : start + size] + data[place + gone :]


def _number(data, chance, seeds, tokens):
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    match = chance.choice(found)
    return data[: match.start()] + chance.choice(NUMBERS) + data[match.end() :]


def _word(data, chance, seeds, tokens):
    words = list(re.finditer(rb"\S+", data))
    if not words:
        return data
    match = chance.choice(words)
    return data[: match.start()] + chance.choice((*tokens, *TOKENS)) + data[match.end() :]


def _lines(data, chance, seeds, tokens):
    lines = data.split(b"\n")
    i, j = chance.randrange(len(lines)), chance.randrange(len(lines))
    action = chance.randrange(4)
    if action == 0:
        del lines[i]
    elif action == 1:
        lines.insert(j, lines[i])
    elif action == 2:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i] = chance.choice((*tokens, b"")) + b" " + chance.choice(NUMBERS)
    return b"\n".join(lines)


_PLAIN = (
    _flip,
    _set_bytes,
    _set_integer,
    _truncate,
    _remove,
    _double,
    _insert,
    _splice,
    _number,
    _number,
    _word,
    _lines,
)


def _part(data, chance):
    start = chance.randrange(len(data) + 1)
    return start, chance.randint(0, min(len(data) - start, chance.choice((1, 4, 16, 64, 1024))))


def in_json(data: bytes, chance: random.Random) -> bytes:
    """Change a value, a key or the nesting of a JSON text; as it is if it is none."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return data
    holders = list(_holders(document))
    value = chance.choice(VALUES)
    if chance.random() < 0.03:
        return b"[" * 100_000 if chance.random() < 0.5 else b'{"a":' * 100_000
    if not holders:
        return json.dumps(value).encode()
    holder = chance.choice(holders)
    key = chance.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    action = chance.randrange(6)
    if action == 0:
        del holder[key]
    elif action == 1 and isinstance(holder, dict):
        holder[chance.choice(("", "x", "__class__", "materials", "\0", *map(str, holder)))] = holder.pop(key)
    elif action == 2:
        holder[key] = [holder[key]]
    else:
        holder[key] = value
    try:
        return json.dumps(document).encode()
    except (ValueError, RecursionError):
        return data


def _holders(value):
    if isinstance(value, (dict, list)) and value:
        yield value
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _holders(inner)


def in_png(data: bytes, chance: random.Random) -> bytes:
    """Change the inside of a PNG chunk and give it the checksum of what it holds; as it is if it is no PNG."""
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return data
    chunks, place = [], 8
    while place + 12 <= len(data):
        (size,) = struct.unpack_from(">I", data, place)
        if place + 12 + size > len(data):
            break
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + size]))
        place += 12 + size
    if not chunks:
        return data
    i = chance.randrange(len(chunks))
    kind, content = chunks[i]
    action = chance.randrange(4)
    if action == 0:
        chunks.insert(chance.randrange(len(chunks) + 1), chunks[i])
    elif action == 1:
        del chunks[i]
    elif action == 2 and kind == b"IDAT":
        with contextlib.suppress(zlib.error):
            rows = chance.choice((_flip, _truncate, _double))(zlib.decompress(content), chance, (), ())
            chunks[i] = (kind, zlib.compress(rows))
    else:
        chunks[i] = (kind, chance.choice((_flip, _set_bytes, _set_integer, _truncate))(content, chance, (), ()))
    packed = b"".join(struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks)
    return data[:8] + packed


def in_archive(data: bytes, chance: random.Random) -> bytes:
    """Change one of the records of a ZIP archive and pack it again; as it is if it is no archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            records = [(name, archive.read(name)) for name in archive.namelist()]
    except Exception:  # what zipfile stumbles on is of no interest here
        return data
    if not records:
        return data
    i = chance.choice([0, 0, 0, chance.randrange(len(records))])
    name, content = records[i]
    action = chance.randrange(8)
    if action == 0:
        del records[i]
    elif action == 1:
        records[i] = (chance.choice(("../../x", "/tmp/x", "a/data/0", "", name + "x")), content)
    else:
        tools = (_flip, _set_bytes, _set_integer, _truncate, _remove, _double, _pickle_number, _pickle_number)
        records[i] = (name, chance.choice(tools)(content, chance, (content,), ()))
    made = io.BytesIO()
    kind = zipfile.ZIP_DEFLATED if chance.random() < 0.05 else zipfile.ZIP_STORED
    with zipfile.ZipFile(made, "w", kind) as archive:
        for name, content in records:
            # A name twice is a warning of zipfile, and a case of its own.
            archive.writestr(zipfile.ZipInfo(name), content)
    return made.getvalue()


def _pickle_number(data, chance, seeds, tokens):
    """Put another integer in the place of a pickled one."""
    places = [i for i in range(len(data) - 1) if data[i : i + 1] in (b"K", b"M", b"J")]
    if not places:
        return data
    place = chance.choice(places)
    size = {b"K": 1, b"M": 2, b"J": 4}[data[place : place + 1]]
    value = chance.choice((0, 1, 3, 255, 65535, -1, 2**31 - 1, -(2**31)))
    return data[:place] + b"J" + struct.pack("<i", value) + data[place + 1 + size :]


_NUMBERS = (float("nan"), float("inf"), -1.0, 0.0, 1e300, -1e-300, 2.0**53, 255.0, 532.0)
_SHAPES = ((0,), (1,), (2,), (3, 3), (6, 8), (8, 6), (2, 2, 8), (1 << 20, 1 << 10), (1 << 40,), (5, 0, 7))


def in_hdf5(data: bytes, chance: random.Random) -> bytes:
    """Change an attribute or an array of an HDF5 file; as it is if it is none. Archives change as archives."""
    if data.startswith(b"PK"):
        return in_archive(data, chance)
    import h5py
    import numpy as np

    try:
        with h5py.File(io.BytesIO(data), "r") as store:
            if sum(store[name].nbytes for name in store) > 1 << 20:
                return data
            values = {name: store[name][()] for name in store if store[name].dtype.kind in "iuf"}
            # Over a broken heap of texts of variable length HDF5 loops for ever.
            kinds = {name: store.attrs.get_id(name).dtype.kind for name in store.attrs}
            header = {name: store.attrs[name] for name, kind in kinds.items() if kind in "iufS"}
    except Exception:  # what h5py stumbles on is of no interest here
        return data
    if not values or not header:
        return data
    name, key, options = chance.choice(list(values)), chance.choice(list(header)), {}
    array, shape, action = values[name], None, chance.randrange(9)
    if action == 0:
        header[key] = chance.choice((*_NUMBERS, "x", "\x01", [1, 2, 3], [], np.zeros(9000), True, -3, 2**62))
    elif action == 1:
        del values[name]
    elif action == 2 and np.size(array):
        wide = np.array(array, dtype=chance.choice((np.float64, np.float32, array.dtype)))
        with np.errstate(all="ignore"):
            wide.flat[chance.randrange(wide.size)] = np.array(chance.choice(_NUMBERS)).astype(wide.dtype)
        values[name] = wide
    elif action == 3:
        values[name] = np.array(array).astype(chance.choice(("f2", "i8", ">f8", "u1", "S3", "c8", "?")))
    elif action == 4:
        values[name] = np.resize(array, chance.choice([s for s in _SHAPES if np.prod(s) < 1000]))
    elif action == 5:
        values[chance.choice(("dark", "x", "a/b", *values))] = array
    elif action == 6:
        del header[key]
    else:
        # Arrays that are promised and not there; chunks of one element, or of all.
        shape = chance.choice(_SHAPES)
        options = {"dtype": chance.choice(("f8", "u1", "i4"))}
        if action == 8 and 0 not in shape:
            options |= {"chunks": chance.choice((tuple([1] * len(shape)), tuple(min(n, 1 << 12) for n in shape)))}
            options |= {"compression": "gzip"} if chance.random() < 0.5 else {}
    with h5py.File("made.h5", "w", driver="core", backing_store=False) as store:
        with contextlib.suppress(ValueError, TypeError, OSError):
            for each, value in values.items():
                promise = {"shape": shape, **options} if shape is not None and each == name else {"data": value}
                store.create_dataset(each, **promise)
            store.attrs.update(header)
        store.flush()
        return store.id.get_file_image()
