"""Bad input of every kind we could think of: status 2 and one line that names the trouble, never a traceback."""

from __future__ import annotations

import io
import os
import pickle
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from decoder.design import GRID, DesignError, VoxelDesign
from decoder.sketch import load_design

Maker = Callable[[Path, VoxelDesign], list[object]]


class Trap:
    """An object whose pickle would leave a file behind if anything ever loaded it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return open, (str(self.path), "w")


def arrays(design: VoxelDesign, folder: Path) -> dict[str, np.ndarray]:
    """What a good design file holds, to be spoilt."""
    design.save(folder / "good.npz")
    with np.load(folder / "good.npz") as archive:
        return {name: archive[name].copy() for name in archive.files}


def spoilt(change: Callable[[dict[str, np.ndarray]], object]) -> Maker:
    """A design file with one thing wrong in it."""

    def make(folder: Path, design: VoxelDesign) -> list[object]:
        stored = arrays(design, folder)
        change(stored)
        np.savez(folder / "bad.npz", **stored)
        return ["score", folder / "bad.npz"]

    return make


def content(name: str, data: bytes | Callable[[bytes], bytes]) -> Maker:
    """A file of these bytes, or of the bytes of a good design after this treatment."""

    def make(folder: Path, design: VoxelDesign) -> list[object]:
        design.save(folder / "good.npz")
        good = (folder / "good.npz").read_bytes()
        (folder / name).write_bytes(data if isinstance(data, bytes) else data(good))
        return ["score", folder / name]

    return make


def words(*argv: object) -> Maker:
    """A command line as it stands; {tmp} is a fresh folder, {good} a good design, {file} a file that is in the way."""

    def make(folder: Path, design: VoxelDesign) -> list[object]:
        design.save(folder / "good.npz")
        (folder / "file").write_text("in the way")
        return [str(w).format(tmp=folder, good=folder / "good.npz", file=folder / "file") for w in argv]

    return make


def put(name: str, value: object) -> Maker:
    return spoilt(lambda stored: stored.__setitem__(name, np.asarray(value)))


def cut(name: str) -> Maker:
    return spoilt(lambda stored: stored.pop(name))


def pickled_array(folder: Path, design: VoxelDesign) -> list[object]:
    stored = arrays(design, folder)
    stored["joints"] = stored["material"] = np.array([Trap(folder / "sprung")], dtype=object)
    np.savez(folder / "bad.npz", **stored)
    return ["score", folder / "bad.npz"]


def pickled_file(folder: Path, design: VoxelDesign) -> list[object]:
    (folder / "bad.npz").write_bytes(pickle.dumps(Trap(folder / "sprung")))
    return ["score", folder / "bad.npz"]


def vast_array(folder: Path, design: VoxelDesign) -> list[object]:
    """An array of a petabyte, says its header."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "|u1", "fortran_order": False, "shape": (10**5, 10**5, 10**5)}
    )
    with zipfile.ZipFile(folder / "bad.npz", "w") as archive:
        archive.writestr("material.npy", header.getvalue())
    return ["score", folder / "bad.npz"]


def flip(data: bytes) -> bytes:
    middle = len(data) // 3
    return data[:middle] + bytes(b ^ 0x5A for b in data[middle : middle + 64]) + data[middle + 64 :]


def loop(stored: dict[str, np.ndarray]) -> None:
    for name in ("position", "axis", "range", "link", "confidence"):
        stored[name] = np.concatenate([stored[name], stored[name]])


def fill(stored: dict[str, np.ndarray]) -> None:
    stored["material"] = np.full((GRID,) * 3, 2, np.uint8)
    stored["segment"] = np.ones((GRID,) * 3, np.int16)
    for name in ("position", "axis", "range", "link", "confidence"):
        stored[name] = stored[name][:0]


def chunk(name: bytes, body: bytes, children: bytes = b"") -> bytes:
    return name + struct.pack("<ii", len(body), len(children)) + body + children


def vox(*chunks: bytes, version: int = 150) -> bytes:
    return b"VOX " + struct.pack("<i", version) + chunk(b"MAIN", b"", b"".join(chunks))


SIZE = chunk(b"SIZE", struct.pack("<iii", 20, 20, 20))
VOXEL = chunk(b"XYZI", struct.pack("<i4B", 1, 5, 5, 5, 1))

DESIGNS: dict[str, tuple[Maker, str]] = {
    "missing file": (words("score", "{tmp}/nothing.npz"), "nothing.npz: No such file"),
    "folder instead of a file": (words("score", "{tmp}"), "is a folder"),
    "empty file": (content("bad.npz", b""), "not a readable design"),
    "unknown suffix": (content("bad.docx", b"hello"), "docx"),
    "no suffix": (content("bad", b"hello"), "bad"),
    "mesh": (content("bad.stl", b"solid x"), "mesh"),
    "text in an npz": (content("bad.npz", b"material,segment\n1,2\n"), "not a readable design"),
    "truncated npz": (content("bad.npz", lambda good: good[: len(good) // 2]), "not a readable design"),
    "npz without its last bytes": (content("bad.npz", lambda good: good[:-7]), "not a readable design"),
    "flipped bits": (content("bad.npz", flip), "bad.npz"),
    "npy instead of npz": (content("bad.npz", b"\x93NUMPY\x01\x00"), "bad.npz"),
    "pickle inside an array": (pickled_array, "bad.npz"),
    "pickle instead of an npz": (pickled_file, "bad.npz"),
    "an array of a petabyte": (vast_array, "bad.npz"),
    "another kind of archive": (spoilt(lambda s: s.clear()), "lacks format"),
    "array missing": (cut("segment"), "lacks segment"),
    "another format": (put("format", "minecraft"), "minecraft"),
    "a later version": (put("version", 99), "version is 99"),
    "wrong shape": (put("material", np.ones((32, 32, 32), np.uint8)), r"shape \(32, 32, 32\)"),
    "flat array": (put("material", np.ones(GRID**3, np.uint8)), "shape"),
    "wrong dtype": (put("material", np.full((GRID,) * 3, 0.5)), "float64"),
    "strings for voxels": (put("segment", np.full((GRID,) * 3, "a")), "whole numbers"),
    "unknown material": (spoilt(lambda s: s["material"].__setitem__((20, 30, 30), 9)), "material holds 9"),
    "empty grid": (spoilt(lambda s: (s["material"].fill(0), s["segment"].fill(0))), "no rigid voxel"),
    "one huge segment": (spoilt(fill), "border of the grid"),
    "rigid voxel of no segment": (spoilt(lambda s: s["segment"].__setitem__((20, 30, 30), 0)), "segment 0"),
    "negative segment": (spoilt(lambda s: s["segment"].__setitem__((20, 30, 30), -4)), "-4"),
    "segment id beyond 16 bits": (spoilt(lambda s: s.update(segment=s["segment"].astype(np.int64) * 10**6)), "32767"),
    "pitch of zero": (put("pitch", 0.0), "pitch is 0"),
    "pitch not a number": (put("pitch", np.nan), "pitch"),
    "two pitches": (put("pitch", [0.01, 0.01]), "pitch"),
    "NaN axis": (put("axis", [[np.nan, 0, 1]]), "finite"),
    "axis not of unit length": (put("axis", [[0, 2.0, 0]]), "length 2"),
    "zero axis": (put("axis", [[0.0, 0, 0]]), "length 0"),
    "joint outside the body": (put("position", [[0.6, 0.6, 0.6]]), "outside the body"),
    "joint at infinity": (put("position", [[np.inf, 0.3, 0.3]]), "finite"),
    "reversed range": (put("range", [[0.5, -0.5]]), "range"),
    "range without the painted pose": (put("range", [[0.2, 0.5]]), "hold 0"),
    "joint to a segment that is not there": (put("link", np.array([[1, 7]], np.int32)), "segment 7"),
    "joint of a segment with itself": (put("link", np.array([[1, 1]], np.int32)), "itself"),
    "cyclic joints": (spoilt(loop), "closes a loop"),
    "half a joint": (put("link", np.array([[1, 2], [2, 1]], np.int32)), "shape"),
    "confidence of two": (put("confidence", [2.0]), "confidence"),
    "vox: not one": (content("bad.vox", b"PNG\x00\x00\x00\x00\x00"), "bad.vox"),
    "vox: empty file": (content("bad.vox", b""), "bad.vox"),
    "vox: header only": (content("bad.vox", b"VOX \x96\x00\x00\x00"), "bad.vox"),
    "vox: no voxels": (content("bad.vox", vox()), "bad.vox"),
    "vox: size without voxels": (content("bad.vox", vox(SIZE)), "bad.vox"),
    "vox: voxels without size": (content("bad.vox", vox(VOXEL)), "bad.vox"),
    "vox: cut in a chunk": (content("bad.vox", vox(SIZE, VOXEL)[:-3]), "bad.vox"),
    "vox: chunk longer than the file": (
        content("bad.vox", vox(SIZE, b"XYZI" + struct.pack("<iii", 2**30, 0, 2**28))), "bad.vox",
    ),
    "vox: negative chunk length": (content("bad.vox", vox(SIZE, b"XYZI" + struct.pack("<ii", -8, 0))), "bad.vox"),
    "vox: voxel outside its size": (
        content("bad.vox", vox(SIZE, chunk(b"XYZI", struct.pack("<i4B", 1, 5, 5, 50, 1)))), "bad.vox",
    ),
    "vox: larger than the grid": (
        content("bad.vox", vox(chunk(b"SIZE", struct.pack("<iii", 256, 256, 256)),
                               chunk(b"XYZI", struct.pack("<i8B", 2, 0, 0, 0, 1, 255, 255, 255, 1)))), "bad.vox",
    ),
    "vox: nothing but soft": (
        content("bad.vox", vox(SIZE, chunk(b"XYZI", struct.pack("<i4B", 1, 5, 5, 5, 200)))), "no bone",
    ),
    "vox: a colour without a meaning": (
        content("bad.vox", vox(SIZE, chunk(b"XYZI", struct.pack("<i4B", 1, 5, 5, 5, 77)))), "palette index 77",
    ),
    "vox: a hinge of one voxel": (
        content("bad.vox", vox(SIZE, chunk(b"XYZI", struct.pack("<i8B", 2, 5, 5, 5, 1, 6, 5, 5, 250)))), "single voxel",
    ),
    "vox: two models": (content("bad.vox", vox(SIZE, VOXEL, SIZE, VOXEL)), "2 models"),
}  # fmt: skip

GENOME = ("--decoder", "genome")  # loads nothing
COMMANDS: dict[str, tuple[Maker, str]] = {
    "no command": (words(), "COMMAND"),
    "unknown command": (words("scroe", "{good}"), "did you mean 'score'"),
    "unknown option": (words("score", "{good}", "--jsno"), "did you mean --json"),
    "no design": (words("score"), "DESIGN"),
    "no output folder": (words("build", "{good}"), "--out"),
    "second file is missing": (words("score", "{tmp}/a.npz", "{tmp}/b.npz"), "a.npz"),
    "negative count": (words("sample", "-n", "-4", "--out", "{tmp}/s"), "out of bounds"),
    "count of zero": (words("sample", "-n", "0", "--out", "{tmp}/s"), "out of bounds"),
    "count in words": (words("sample", "-n", "many", "--out", "{tmp}/s"), "not a whole number"),
    "negative seed": (words("sample", "-n", "1", "--seed", "-1", "--out", "{tmp}/s"), "out of bounds"),
    "vast seed": (words("sample", "-n", "1", "--seed", "9" * 40, "--out", "{tmp}/s"), "out of bounds"),
    "fractional seed": (words("sample", "-n", "1", "--seed", "1.5", "--out", "{tmp}/s"), "not a whole number"),
    "unknown decoder": (words("sample", "-n", "1", "--decoder", "gnome", "--out", "{tmp}/s"), "gnome"),
    "unknown prior": (words("sample", "-n", "1", "--prior", "cauchy", "--out", "{tmp}/s"), "cauchy"),
    "unknown solver": (words("score", "{good}", "--solver", "magic"), "magic"),
    "unknown catalogue": (words("build", "{good}", "--catalogue", "ikea", "--out", "{tmp}/b"), "ikea"),
    "file in the way of samples": (words("sample", "-n", "1", *GENOME, "--out", "{file}"), "is a file"),
    "file in the way of a blueprint": (words("build", "{good}", "--out", "{file}"), "is a file"),
    "file above the output folder": (words("build", "{good}", "--out", "{file}/below"), "is a file"),
    "output in a folder that cannot be": (
        words("sample", "-n", "1", *GENOME, "--out", "/proc/nothing"),
        "/proc/nothing",
    ),
    "name too long": (words("sample", "-n", "1", *GENOME, "--out", "{tmp}/" + "x" * 300), "name too long"),
}


def config(text: str | bytes) -> Maker:
    """A configuration file with this in it."""

    def make(folder: Path, design: VoxelDesign) -> list[object]:
        data = text if isinstance(text, bytes) else text.encode()
        (folder / "bad.toml").write_bytes(data)
        return ["run", folder / "bad.toml", "--out", folder / "run"]

    return make


CONFIGS: dict[str, tuple[Maker, str]] = {
    "config: missing": (words("run", "{tmp}/no.toml", "--out", "{tmp}/run"), "no.toml: No such file"),
    "config: a folder": (words("run", "{tmp}", "--out", "{tmp}/run"), "directory"),
    "config: empty": (config(""), "kind is missing"),
    "config: binary": (config(b"\x80\x81\xff\x00"), "UTF-8"),
    "config: not TOML": (config("kind = evolve"), "not a TOML file"),
    "config: a key twice": (config('kind = "study"\nn = 1\nn = 2'), "not a TOML file"),
    "config: unknown kind": (config('kind = "evolv"'), 'did you mean "evolve"'),
    "config: a policy of no robot": (config('kind = "policy"'), "robot is missing"),
    "config: kind is a number": (config("kind = 3"), "kind = 3"),
    "config: a typo": (config('kind = "evolve"\n[search]\ngenerationz = 3'), "did you mean generations"),
    "config: a typo in a table": (config('kind = "evolve"\n[serch]\nsigma = 1.0'), "did you mean search"),
    "config: a text for a number": (config('kind = "study"\nn = "many"'), "whole number"),
    "config: a fraction for a count": (config('kind = "study"\nn = 1.5'), "whole number"),
    "config: a number for a table": (config('kind = "evolve"\nsearch = 3'), "must be a table"),
    "config: out of bounds": (config('kind = "evolve"\n[search]\npopsize = 1'), "popsize = 1"),
    "config: negative workers": (config('kind = "study"\nworkers = -1'), "workers = -1"),
    "config: not a number": (config('kind = "evolve"\n[search]\nsigma = nan'), "sigma = nan"),
    "config: unknown decoder": (config('kind = "study"\ndecoder = "gnome"'), 'did you mean "genome"'),
    "config: weights are missing": (config('kind = "study"\ndecoder = "no.safetensors"'), "no.safetensors: No such"),
    "config: weights are none": (config('kind = "evolve"\ndecoder = "/dev/null.safetensors"'), "/dev/null.safetensors"),
    "config: unknown catalogue": (config('kind = "study"\ncatalogue = "cheap"'), "catalogue"),
    "config: sketch without a design": (config('kind = "sketch"'), "design is missing"),
    "config: sketch of a missing file": (config('kind = "sketch"\ndesign = "no.vox"'), "no.vox"),
}


def words_with(prepare: Callable[[Path], object], *argv: str) -> Maker:
    """A command line after something was put into {tmp}."""

    def make(folder: Path, design: VoxelDesign) -> list[object]:
        prepare(folder)
        return words(*argv)(folder, design)

    return make


def folder_with(name: str, data: bytes) -> Callable[[Path], object]:
    def prepare(folder: Path) -> None:
        path = folder / "given" / name
        path.parent.mkdir(parents=True)
        path.write_bytes(data)

    return prepare


GIVEN = "{tmp}/given"
FOLDERS: dict[str, tuple[Maker, str]] = {
    "bundle: missing": (words("deploy", GIVEN, "--dry-run"), "given"),
    "bundle: empty folder": (words_with(folder_with("x", b""), "deploy", GIVEN, "--dry-run"), "bundle.json"),
    "bundle: a file": (words("deploy", "{good}", "--dry-run"), "good.npz"),
    "bundle: not JSON": (words_with(folder_with("bundle.json", b"{"), "deploy", GIVEN, "--dry-run"), "bundle.json"),
    "bundle: binary": (words_with(folder_with("bundle.json", b"\xff\x00"), "deploy", GIVEN, "--dry-run"), "bundle"),
    "bundle: another document": (words_with(folder_with("bundle.json", b"[]"), "deploy", GIVEN, "--dry-run"), "bundle"),
    "bundle: nothing in it": (words_with(folder_with("bundle.json", b"{}"), "deploy", GIVEN, "--dry-run"), "bundle"),
    "unknown bus": (words("deploy", GIVEN, "--bus", "carrier-pigeon"), "unknown bus"),
    "dry run on a real bus": (words("deploy", GIVEN, "--bus", "socketcan:can0", "--dry-run"), "dry-run"),
    "no time to deploy": (words("deploy", GIVEN, "--seconds", "0"), "out of bounds"),
    "log: missing": (words("replay", "{tmp}/no.log"), "no.log"),
    "log: text": (words("replay", "{file}"), "file"),
    "log: empty": (words_with(folder_with("frames.log", b""), "replay", GIVEN + "/frames.log"), "frames.log"),
    "log: binary": (words_with(folder_with("frames.log", b"\xff\xfe\x00"), "replay", GIVEN + "/frames.log"), "frames"),
    "report: missing": (words("report", GIVEN), "given"),
    "report: not a run": (words_with(folder_with("x", b""), "report", GIVEN), "given"),
    "report: a file": (words("report", "{file}"), "file"),
    "report: corrupt run file": (words_with(folder_with("run.sqlite", b"no database" * 99), "report", GIVEN), "given"),
    "report: empty run file": (words_with(folder_with("run.sqlite", b""), "report", GIVEN), "given"),
    "run: file in the way": (
        words_with(folder_with("c.toml", b'kind = "evolve"'), "run", GIVEN + "/c.toml", "--out", "{file}"), "is a file",
    ),
    "run: output in a folder that cannot be": (
        words_with(folder_with("c.toml", b'kind = "study"'), "run", GIVEN + "/c.toml", "--out", "/proc/nothing"),
        "/proc/nothing",
    ),
    "run: another kind of run file there": (
        words_with(folder_with("run.sqlite", b"no database" * 99), "run", "experiments/configs/tiny.toml", "--out",
                   GIVEN, "--resume"), "given",
    ),
    "simulate: missing": (words("simulate", GIVEN), "given"),
    "simulate: not a blueprint": (words_with(folder_with("x", b""), "simulate", GIVEN), "given"),
    "simulate: broken model": (words_with(folder_with("robot.xml", b"<mujoco"), "simulate", GIVEN), "given"),
    "simulate: unknown suffix": (words("simulate", "{file}"), "file"),
    "simulate: policy is missing": (words("simulate", "{good}", "--policy", GIVEN), "given"),
    "study: negative count": (words("study", "-n", "-5", "--out", GIVEN), "out of bounds"),
    "study: negative workers": (words("study", "-n", "2", "--workers", "-1", "--out", GIVEN), "workers"),
    "study: unknown decoder": (words("study", "-n", "2", "--decoder", "gnome", "--out", GIVEN), "gnome"),
    "sample: weights are missing": (
        words("sample", "-n", "1", "--decoder", GIVEN + ".safetensors", "--out", "{tmp}/s"), "No such file",
    ),
    "sample: weights are text": (
        words_with(folder_with("w.safetensors", b"trained" * 99), "sample", "-n", "1", "--decoder",
                   GIVEN + "/w.safetensors", "--out", "{tmp}/s"), "w.safetensors: not a readable safetensors file",
    ),
    "study: weights are empty": (
        words_with(folder_with("w.safetensors", b""), "study", "-n", "1", "--decoder", GIVEN + "/w.safetensors",
                   "--out", "{tmp}/s"), "w.safetensors: the file is empty",
    ),
    "study: weights are a folder": (
        words_with(folder_with("w.safetensors/x", b""), "study", "-n", "1", "--decoder", GIVEN + "/w.safetensors",
                   "--out", "{tmp}/s"), "w.safetensors: Is a directory",
    ),
    "study: file in the way": (words("study", "-n", "2", "--out", "{file}"), "is a file"),
}  # fmt: skip
ALL = {**DESIGNS, **COMMANDS, **CONFIGS, **FOLDERS}


def test_every_kind_has_its_own_name():
    assert len(ALL) == sum(map(len, (DESIGNS, COMMANDS, CONFIGS, FOLDERS)))


@pytest.mark.parametrize("kind", ALL)
def test_bad_input_is_one_clear_line_and_status_2(kind, bodyplan, tmp_path, hinge):
    make, fragment = ALL[kind]
    said = bodyplan(*make(tmp_path, hinge))
    one_clear_line(said, fragment)
    assert not (tmp_path / "sprung").exists(), "a pickle was loaded"


def one_clear_line(said, fragment):
    assert said.status == 2
    assert said.out == ""
    assert said.err.startswith("bodyplan: error: ")
    assert said.err.count("\n") == 1, said.err
    assert 30 < len(said.err) < 600
    assert re.search(fragment, said.err, re.IGNORECASE)


@pytest.mark.parametrize("name", ["packed.npz", "plain.npz", "painted.vox"])
def test_a_file_cut_or_altered_anywhere_is_read_or_refused_but_never_more(name, hinge, tmp_path):
    good = {
        "packed.npz": lambda: hinge.save(tmp_path / name),
        # Small arrays, so that the headers, which numpy reads as Python, are a large part of the file.
        "plain.npz": lambda: np.savez(tmp_path / name, **{k: v[:1] if v.ndim == 3 else v
                                                          for k, v in arrays(hinge, tmp_path).items()}),
        "painted.vox": lambda: (tmp_path / name).write_bytes(vox(SIZE, VOXEL, chunk(b"RGBA", bytes(1024)))),
    }  # fmt: skip
    good[name]()
    data, rng, refusals = (tmp_path / name).read_bytes(), np.random.default_rng(0), []
    for k in range(200):
        (tmp_path / name).write_bytes(damage(data, k % 4, rng))
        try:
            load_design(tmp_path / name)
        except DesignError as error:
            refusals.append(str(error))
    assert len(refusals) > 50
    assert not any("\n" in message for message in refusals)


def damage(data: bytes, bits: int, rng: np.random.Generator) -> bytes:
    """The file cut off somewhere, or with some bits turned: anywhere if it is one, near the start if more."""
    if bits == 0:
        return data[: rng.integers(len(data))]
    altered = bytearray(data)
    for place in rng.integers(len(data) if bits == 1 else min(len(data), 900), size=bits):
        altered[place] ^= 1 << rng.integers(8)
    return bytes(altered)


def test_a_full_disk_is_one_clear_line(bodyplan, tmp_path, monkeypatch):
    def full(*_args, **_kwargs):
        raise OSError(28, os.strerror(28), str(tmp_path / "s" / "body_0.npz"))

    monkeypatch.setattr(VoxelDesign, "save", full)
    one_clear_line(bodyplan("sample", "-n", "1", *GENOME, "--out", tmp_path / "s"), "No space left on device")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has /dev/full")
def test_a_full_disk_at_the_first_write_is_one_clear_line(bodyplan, tmp_path):
    folder = tmp_path / "s"
    folder.mkdir()
    (folder / "body_0.npz").symlink_to("/dev/full")
    one_clear_line(bodyplan("sample", "-n", "1", *GENOME, "--out", folder), "No space left on device")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_one_clear_line(bodyplan, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o555)
    one_clear_line(bodyplan("sample", "-n", "1", *GENOME, "--out", tmp_path / "locked" / "s"), "Permission denied")


def test_a_file_that_may_not_be_read_is_one_clear_line(bodyplan, tmp_path, hinge, monkeypatch):
    hinge.save(tmp_path / "secret.npz")
    monkeypatch.setattr(VoxelDesign, "load", _denied(tmp_path / "secret.npz"))
    one_clear_line(bodyplan("score", tmp_path / "secret.npz"), "Permission denied")


def _denied(path):
    def load(*_args):
        raise PermissionError(13, os.strerror(13), str(path))

    return load
