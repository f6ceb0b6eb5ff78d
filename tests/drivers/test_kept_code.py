"""Compiled code that is damaged, another's, or cannot be kept: compiled again, nothing worse."""

import math
import os
import pwd
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

from pcpc.drivers.compiled import compile_cache, kept_files
from pcpc.executive.own_laws import law_errors
from pcpc.executive.own_laws.modules import module_of

LAW = "from pcpc.drivers.compiled.jit import compiled, f8\n" + "".join(
    f"@compiled(f8(f8))\ndef times{i}(x):\n    return {i}.0 * x\n\n" for i in range(10)
)
MAIN = """
import pathlib, sys
from pcpc.drivers.compiled import compile_cache
compile_cache.SHIPPED = pathlib.Path(sys.argv[1])
import law
print([getattr(law, f"times{i}")(1.5) / 1.5 for i in range(10)] == list(range(10)))
print(compile_cache.watch.done)
"""


class Machine:
    """Processes that import one module of ten compiled functions, with caches of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.cache, self.temporary = folder, folder / "cache", folder / "tmp"
        self.shipped = folder / "shipped" / os.uname().machine
        self.temporary.mkdir()
        (folder / "law.py").write_text(LAW)

    def run(self, before: Sequence[str] = ()) -> tuple[int, str]:
        """Return how many functions were compiled and what was said; the results are right."""
        environment = os.environ | {
            "PYTHONPATH": f"{ROOT}:{self.folder}", "PYTHONDONTWRITEBYTECODE": "1",
            "XDG_CACHE_HOME": str(self.cache), "TMPDIR": str(self.temporary),
        }  # fmt: skip
        done = subprocess.run(
            [*before, sys.executable, "-c", MAIN, str(self.shipped.parent)],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        right, compiled = done.stdout.split()
        assert right == "True", done.stdout
        return int(compiled), done.stderr

    def files(self, pattern: str) -> list[Path]:
        return sorted(self.cache.rglob(pattern))


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """Return a machine with nothing compiled."""
    return Machine(tmp_path)


def flipped(whole: bytes) -> bytes:
    return bytes([*whole[:-9], whole[-9] ^ 4, *whole[-8:]])


DAMAGE: tuple[Callable[[bytes], bytes], ...] = (
    lambda whole: b"", lambda whole: whole[: len(whole) // 2], lambda whole: whole + b"x",
    lambda whole: b"garbage" * 99, flipped,
)  # fmt: skip


def test_shipped_code_is_read_and_not_written(machine: Machine) -> None:
    assert machine.run() == (10, "")
    machine.shipped.parent.mkdir()
    (machine.cache / "pcpc" / "compiled").rename(machine.shipped)
    before = {file: file.read_bytes() for file in machine.shipped.rglob("*.nb?")}
    assert machine.run() == (0, "") and not machine.files("*.nb?")
    damaged = sorted(file for file in before if file.suffix == ".nbc")[3]
    damaged.write_bytes(flipped(before[damaged]))
    assert machine.run() == (1, "") and len(machine.files("*.nbc")) == 1
    assert machine.run() == (0, ""), "what was compiled in its place is kept for this user"
    damaged.write_bytes(before[damaged])
    assert {file: file.read_bytes() for file in machine.shipped.rglob("*.nb?")} == before
    machine.shipped.rename(machine.shipped.with_name("riscv64"))
    assert machine.run()[0] == 9, "code of another machine is not run"
    machine.shipped.with_name("riscv64").rename(machine.shipped)
    machine.shipped.chmod(0o777)
    (machine.shipped / compile_cache.source_hash()).chmod(0o777)
    shutil.rmtree(machine.cache)
    assert machine.run()[0] == 10, "code that everybody may write is not run"


def test_damaged_files_are_compiled_again_and_mended(machine: Machine) -> None:
    assert machine.run() == (10, "")
    assert machine.run() == (0, "")
    assert not list(machine.temporary.rglob("*")), "nothing is made where all is well"
    for damage, file in zip(DAMAGE * 2, machine.files("*.nbc"), strict=True):
        file.write_bytes(damage(file.read_bytes()))
    assert machine.run() == (10, "")
    for file in machine.files("*.nbc")[:2]:  # what cannot even be overwritten
        file.unlink()
        file.mkdir()
    first, second = machine.files("*.nbc")[-2:]
    first.write_bytes(second.read_bytes())  # code of another function
    compiled, said = machine.run()
    assert compiled == 3 and "Is a directory; it goes to " in said, said
    assert machine.run() == (0, "")


def test_a_damaged_file_of_a_helper_is_written_again(tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text(
        "from pcpc.drivers.compiled.jit import compiled\n"
        "@compiled()\ndef helper(x):\n    return 2.0 * x\n"
        + "".join(f"@compiled()\ndef f{i}(x):\n    return helper(x) + {i}.0\n" for i in range(7))
    )
    main = "import law; from pcpc.drivers.compiled.compile_cache import watch; "
    mine = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": f"{ROOT}:{tmp_path}"}

    def compiled(i: int) -> str:
        words = [sys.executable, "-c", f"{main}print(law.f{i}(1.0), watch.done)"]
        done = subprocess.run(
            words, check=True, capture_output=True, text=True, cwd=tmp_path, env=os.environ | mine
        )
        assert done.stderr == "", done.stderr
        return done.stdout.strip()

    assert compiled(0) == "2.0 2"
    assert compiled(1) == "3.0 1", "the helper is kept"
    (kept,) = (tmp_path / "cache").rglob("law.helper-*.nbc")
    for i, damage in enumerate(DAMAGE):
        kept.write_bytes(damage(kept.read_bytes()))
        assert compiled(2 + i) == f"{4.0 + i} 2", "the helper again"


def test_a_disk_without_room_costs_the_cache_and_nothing_else(machine: Machine) -> None:
    compiled, said = machine.run(["prlimit", "--fsize=0"])
    assert compiled == 10, said
    assert said.count("\n") == 1, said
    assert f"compiled code cannot be kept in {machine.cache}" in said, said
    assert said.endswith(": File too large; it is compiled again at every start\n"), said


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (OSError(), "OSError"), (PermissionError(), "PermissionError"), (OSError("odd"), "odd"),
        (OSError(28, "No space left on device"), "No space left on device"),
        (None, kept_files.MENDED),
    ],
)  # fmt: skip
def test_a_place_that_takes_no_code_is_never_named_without_a_reason(
    error: OSError | None, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(kept_files, "_told", [])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    wanted, other = compile_cache.cache_folder(), tmp_path / "other"

    def keep(place: int) -> None:
        if error is not None and place == 0:
            raise error

    folders = [wanted / "a", other / "a"] if error is not None else [other / "a"]
    kept_files.keep_first(folders, keep)
    said = capsys.readouterr().err
    assert said == f"compiled code cannot be kept in {wanted}: {why}; it goes to {other}\n", said


@pytest.mark.parametrize(("short_s", "said"), [(0.0, [str(os.getpid())]), (math.inf, [])])
def test_a_long_wait_for_who_compiles_the_same_is_said_once(
    short_s: float, said: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    holders: list[str] = []
    monkeypatch.setattr(compile_cache, "SHORT_S", short_s)
    monkeypatch.setattr(compile_cache, "watch", compile_cache._Watch())
    held = kept_files.claim(tmp_path, "f")
    assert held is not None

    def note(done: bool, holder: str = "") -> None:
        holders.append(holder)
        held.close()

    compile_cache.watch.listener = note
    if math.isinf(short_s):
        threading.Timer(0.1, held.close).start()
    again = kept_files.claim(tmp_path, "f")
    assert held.closed and again is not None and holders == said
    again.close()


def test_a_cache_that_is_no_folder_is_bypassed(machine: Machine) -> None:
    machine.cache.touch()
    compiled, said = machine.run()
    place = machine.temporary / f"pcpc-{os.geteuid()}" / "compiled" / compile_cache.source_hash()
    assert compiled == 10 and said.endswith(f"; it goes to {place}\n"), said
    assert machine.run() == (0, "")
    modes = {path.stat().st_mode & 0o777 for path in (place, *place.parents[:2])}
    assert modes == {0o700}, modes


def test_code_of_another_user_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    mine.mkdir()
    theirs.mkdir()
    if os.geteuid() == 0:
        os.chown(theirs, 12345, 12345)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert compile_cache.distrust(theirs / "a" / "b") != ""
    assert compile_cache.distrust(theirs).startswith(f"{theirs} belongs to user ")
    with pytest.raises(PermissionError):
        compile_cache.make(theirs / "a")
    mine.chmod(0o777)
    assert compile_cache.distrust(mine) != ""


@pytest.mark.parametrize("home", [None, "not/absolute"])
def test_a_user_without_a_home_has_a_cache(
    home: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nobody(number: int) -> None:
        raise KeyError(number)

    monkeypatch.setattr(pwd, "getpwuid", nobody)
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the standard says: ignore it
    monkeypatch.delenv("HOME", raising=False)
    if home is not None:
        monkeypatch.setenv("HOME", home)
    monkeypatch.setattr(compile_cache.tempfile, "tempdir", str(tmp_path))
    place = tmp_path / f"pcpc-{os.geteuid()}" / "compiled" / compile_cache.source_hash()
    assert compile_cache.folders() == [place]


def test_copies_of_the_project_with_equal_sources_share_code_and_others_do_not(
    tmp_path: Path,
) -> None:
    main = "from pcpc.drivers.compiled.compile_cache import watch; "
    main += "import pcpc.executive.laws.idle as _; print(watch.done)"
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}

    def compiled(root: Path) -> int:
        """Return what a copy compiles of one module."""
        words = [sys.executable, "-c", main]
        more = {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            words, check=True, capture_output=True, text=True, cwd=tmp_path, env=environment | more
        )
        return int(done.stdout)

    for name in ("one", "two"):
        for folder in ("drivers", "executive", "pcpc"):
            without = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / folder, tmp_path / name / folder, symlinks=True, ignore=without)
        (tmp_path / name / "plants").mkdir()
    one, two = tmp_path / "one", tmp_path / "two"
    for file in two.rglob("*.py"):
        os.utime(file, (1e9, 1e9))  # a clone has times of its own
    assert compiled(one) > 0
    assert compiled(two) == 0, "the folder's name is not in the key"
    (two / "plants/table.csv").write_text("1.0\n")
    assert compiled(two) == 0, "nothing in the executive can know of a plant"
    (two / "executive/table.csv").write_text("1.0\n")  # a module may read it at its import
    assert compiled(two) > 0
    assert compiled(one) == 0


def test_a_function_whose_file_was_edited_before_it_is_compiled_is_not_kept_under_the_new_text(
    tmp_path: Path,
) -> None:
    """The cache of a function is set up when it is compiled, which may be long after its import."""
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}
    text = "from pcpc.drivers.compiled.jit import compiled\n\n"
    text += "@compiled()\ndef f(x):\n    return x + {}\n"
    main = "import sys; sys.path.insert(0, '.'); import law; {} print(law.f(1.0))"
    (tmp_path / "law.py").write_text(text.format("1.0"))
    edit = f"open('law.py', 'w').write({text.format('20.0')!r});"

    def said(before: str) -> str:
        words = [sys.executable, "-c", main.format(before)]
        done = subprocess.run(
            words, check=True, capture_output=True, text=True, cwd=tmp_path, env=environment
        )
        return done.stdout.strip()

    assert said(edit) == "2.0", "what was imported is what runs"
    assert said("") == "21.0"
    assert said("") == "21.0"


def test_what_an_import_makes_of_the_environment_is_in_the_key(tmp_path: Path) -> None:
    """Also where a module or a function beside the law made it, as a number or as a table."""
    (tmp_path / "beside.py").write_text(
        "import os\nimport numpy as np\nfrom pcpc.drivers.compiled.jit import inline\n"
        "OFFSET = float(os.environ['OFFSET'])\nTABLE = np.array([float(os.environ['ENTRY'])])\n"
        "@inline\ndef entry():\n    return TABLE[0]\n"
    )
    (tmp_path / "law.py").write_text(
        "import os\nimport beside\nfrom beside import entry\n"
        "from pcpc.drivers.compiled.jit import compiled\nGAINS = (float(os.environ['GAIN']), 0.0)\n"
        "@compiled()\ndef f(x):\n    return GAINS[0] * x + beside.OFFSET + entry()\n"
    )
    main = "import sys; sys.path.insert(0, '.'); import law; print(law.f(1.0)); "
    main += "from pcpc.drivers.compiled.compile_cache import watch; print(watch.done)"

    def said(**constants: str) -> list[str]:
        mine = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}
        values = {"GAIN": "2", "OFFSET": "10", "ENTRY": "100"} | constants
        done = subprocess.run(
            [sys.executable, "-c", main],
            check=True,
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=os.environ | mine | values,
        )
        return done.stdout.split()

    assert said() == ["112.0", "2"]
    assert said() == ["112.0", "0"], "equal constants: nothing is compiled again"
    assert said(GAIN="3")[0] == "113.0"
    assert said(OFFSET="20")[0] == "122.0"
    assert said(ENTRY="200")[0] == "212.0"
    assert said() == ["112.0", "0"]


def test_an_edit_two_files_below_a_law_is_noticed(tmp_path: Path) -> None:
    """What a helper's callers link in has in it what that helper calls."""
    head = "from pcpc.drivers.compiled.jit import compiled\n"
    gain = "@compiled()\ndef gain(x):\n    return {} * x\n"
    made = "def made(k):\n    @compiled()\n    def f(x):\n        return k * x\n    return f\n"
    (tmp_path / "middle.py").write_text(
        f"{head}from below import by_factory, gain\n"
        "@compiled()\ndef helper(x):\n    return gain(x) + by_factory(x)\n"
    )
    (tmp_path / "law.py").write_text(
        f"{head}from middle import helper\n@compiled()\ndef f(x):\n    return helper(x)\n"
    )
    main = "import sys; sys.path.insert(0, '.'); import law; print(law.f(1.0)); "
    main += "from pcpc.drivers.compiled.compile_cache import watch; print(watch.done)"
    mine = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}
    mine["PYTHONDONTWRITEBYTECODE"] = "1"  # Python tells edits within a second by size only

    def said(first: float, second: float) -> list[str]:
        text = f"{head}{gain.format(first)}{made}by_factory = made({second})\n"
        (tmp_path / "below.py").write_text(text)
        words = [sys.executable, "-c", main]
        done = subprocess.run(
            words, check=True, capture_output=True, text=True, cwd=tmp_path, env=os.environ | mine
        )
        return done.stdout.split()

    assert said(2.0, 10.0)[0] == "12.0"
    assert said(2.0, 10.0) == ["12.0", "0"]
    assert said(3.0, 10.0)[0] == "13.0", "other code"
    assert said(3.0, 20.0)[0] == "23.0", "another constant of a closure"
    assert said(2.0, 10.0)[0] == "12.0"


def test_a_folder_of_the_environment_is_one_of_these_sources_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A user's law is kept by its path there, and has code of the project inlined."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert compile_cache.cache_folder() == tmp_path / compile_cache.source_hash()


LAW_ALONE = """
import math
from pcpc.drivers.compiled.jit import compiled, f8
@compiled(f8(f8))
def root(x):
    if x < 0.0:
        raise ValueError("no root")
    return math.sqrt(x)
"""


def law_in(folder: Path, text: str) -> tuple[Any, int]:
    """Return the module of a law, and how many functions were compiled for it."""
    folder.mkdir()
    (folder / "law.py").write_text(text)
    before = compile_cache.watch.done
    return module_of("", folder / "law.py"), compile_cache.watch.done - before


def test_a_law_that_stands_alone_is_compiled_once_wherever_it_lies(tmp_path: Path) -> None:
    text = f"# {tmp_path}{LAW_ALONE}"
    one, first = law_in(tmp_path / "one", text)
    two, second = law_in(tmp_path / "two", text)
    assert first > 0 and second == 0, f"{first} and {second} compiled"
    assert one.__file__ != two.__file__ and one.root(4.0) == two.root(4.0) == 2.0
    shutil.rmtree(tmp_path / "one")
    with pytest.raises(ValueError, match="no root") as raised:
        two.root(-1.0)
    told = law_errors.cause(raised.value)
    assert told.startswith(f"{tmp_path}/two/law.py:7: ") and "`raise ValueError" in told, told


@pytest.mark.parametrize(
    "line",
    [
        "import beside_law",
        "FOLDER = __file__",
        "TABLE = open('table.txt').read()",
    ],
)
def test_a_law_that_depends_on_its_folder_is_compiled_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("beside_law.py", "table.txt"):
        (tmp_path / name).touch()
    text = f"# {tmp_path}{LAW_ALONE}{line}\n"
    assert law_in(tmp_path / "one", text)[1] > 0
    assert law_in(tmp_path / "two", text)[1] > 0
