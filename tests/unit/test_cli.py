"""The command line: what it prints where, and the exit status it leaves with."""

from __future__ import annotations

import csv
import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

from svprep import cli, pipeline
from svprep.cli_options import memory_of
from svprep.defects import Code
from svprep.errors import InternalError

ROOT = Path(__file__).resolve().parents[2]
CONFORMANCE = ROOT / "data" / "conformance"
CITY = ROOT / "data" / "small_city.obj.gz"


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def svprep(*arguments: str, **options) -> subprocess.CompletedProcess:
    """Run the command line in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "svprep", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, env=environment, check=False, **options
    )


def test_build_info_validate(capfd: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["build", str(CONFORMANCE / "open_shell.obj")]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert "D302 OPEN_SHELL" in out
    assert Path("open_shell.svp.h5").is_file()
    assert cli.run(["info", "open_shell.svp.h5"]) == 0
    assert "mesh/face_corners" in capfd.readouterr().out
    assert cli.run(["validate", "open_shell.svp.h5"]) == 0
    assert capfd.readouterr().out.endswith("valid\n")


def test_json_is_one_object_and_nothing_else(capfd: pytest.CaptureFixture[str]) -> None:
    model = str(CONFORMANCE / "clean_cube.obj")
    assert cli.run(["build", model, "-o", "a.svp.h5", "--json"]) == 0
    out, err = capfd.readouterr()
    built = json.loads(out)
    assert err == ""
    assert (built["faces"], built["solid"], built["defects"]) == (12, 1, {})
    assert set(built["seconds"]) == set(pipeline.STAGES)
    assert cli.run(["info", "a.svp.h5", "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["content_digest"] == built["content_digest"]
    assert told["sources"][0]["path"] == model
    assert cli.run(["validate", "a.svp.h5", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["valid"] is True
    assert cli.run(["validate", "--explain", "D302", "--json"]) == 0
    assert "OPEN_SHELL" in json.loads(capfd.readouterr().out)["text"]


def test_damage_is_named_and_ends_in_1(capfd: pytest.CaptureFixture[str]) -> None:
    cli.run(["build", str(CITY), "-o", "a.svp.h5"])
    with h5py.File("a.svp.h5") as file:
        offset = file["mesh/positions"].id.get_offset()
    whole = bytearray(Path("a.svp.h5").read_bytes())
    whole[offset] ^= 1
    Path("a.svp.h5").write_bytes(whole)
    capfd.readouterr()
    assert cli.run(["validate", "a.svp.h5"]) == 1
    out, err = capfd.readouterr()
    assert "mesh/positions" in out
    assert "--explain V2" in out
    assert err == ""
    assert cli.run(["validate", "a.svp.h5", "--json"]) == 1
    problems = json.loads(capfd.readouterr().out)["problems"]
    assert len(problems) == 1


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["frobnicate"], 2, "No such command"),
        (["build"], 2, "INPUT"),
        (["build", "--weld-tolerance", "much", "x.obj"], 2, "--weld-tolerance"),
        (["build", "--weld-tolerance", "-1", "x.obj"], 2, "metres"),
        (["build", "--weld-tolerance", "nan", "x.obj"], 2, "metres"),
        (["build", "gone.obj"], 1, "gone.obj"),
        (["build", "--memory", "much", "x.obj"], 2, "not a size like 512M"),
        (["build", "--memory", "-1G", "x.obj"], 2, "not a size like 512M"),
        (["build", "--memory", "1Q", "x.obj"], 2, "not a size like 512M"),
        (["build", "--memory", "", "x.obj"], 2, "not a size like 512M"),
        (["build", "--memory", "63M", "x.obj"], 2, "give 64M or more"),
        (["build", f"{'x' * 300}.obj", "-o", "a.svp.h5"], 1, "cannot be read: File name too long"),
        (["build", "gone.obj", "gone2.obj"], 1, "-o CACHE"),
        (["build", "gone.obj", "--report", "r.txt"], 2, ".json or .csv"),
        (["build", "gone.obj", "--report", "no/r.csv"], 1, 'no folder "'),
        (["build", "gone.obj", "-o", "a.json", "--report", "a.json"], 1, "the cache itself"),
        (["build", "gone.json", "-o", "a.h5", "--report", "./gone.json"], 1, "an input"),
        (["info"], 2, "CACHE"),
        (["validate", "--explain"], 2, "(svprep validate --help lists the options)"),
        (["info", "gone.svp.h5"], 1, "gone.svp.h5"),
        (["info", "model.obj"], 1, "svprep build model.obj"),
        (["validate"], 2, "--explain"),
        (["validate", "city.glb"], 1, "svprep build city.glb"),
        (["validate", "--explain", "D999"], 1, "D101"),
        (["validate", "--explain", ""], 1, "D101"),
    ],
)
def test_one_line_on_standard_error(
    arguments: list[str], status: int, says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(arguments) == status
    out, err = capfd.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "n_bytes"),
    [
        ("1G", 2**30),
        ("512M", 2**29),
        ("1.5GiB", 3 * 2**29),
        ("2 tb", 2**41),
        ("65536k", 2**26),
        ("100000000", 10**8),
        ("100000000B", 10**8),
    ],
)
def test_sizes_of_memory(text: str, n_bytes: int) -> None:
    assert memory_of(text) == n_bytes


@pytest.mark.parametrize("given", ["zero", "0"])
def test_a_thread_count_that_is_none_is_told_in_one_line(
    given: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("SVPREP_THREADS", given)
    assert cli.run(["build", str(CONFORMANCE / "clean_cube.obj")]) == 1
    out, err = capfd.readouterr()
    assert out == ""
    assert f'SVPREP_THREADS is "{given}"' in err
    assert err.count("\n") == 1
    assert not list(Path.cwd().iterdir())


def test_an_older_cache_is_used_unless_full_is_asked_for(
    capfd: pytest.CaptureFixture[str],
) -> None:
    model = str(CONFORMANCE / "clean_cube.obj")
    digests = set()
    for options, n_reused in (([], 0), ([], 1), (["--full"], 0), (["--memory", "256M"], None)):
        assert cli.run(["build", model, "-o", "a.svp.h5", "--json", *options]) == 0
        built = json.loads(capfd.readouterr().out)
        digests.add(built["content_digest"])
        assert n_reused in (None, built["reused_objects"])
        assert {row["name"]: row["seconds"] for row in built["stages"]} == built["seconds"]
        for row in built["stages"]:
            assert set(row) == {"name", "seconds", "peak_mb", "mtri_per_s", "bytes_written"}
    assert len(digests) == 1
    assert cli.run(["build", model, "-o", "a.svp.h5"]) == 0
    said = capfd.readouterr().out
    assert "reused   1 of 1 objects, from the older cache; --full builds all again" in said
    assert "memory   at most" in said


def test_a_build_says_that_it_held_more_than_it_was_to(capfd: pytest.CaptureFixture[str]) -> None:
    model = str(CONFORMANCE / "clean_cube.obj")
    for memory, is_more in (("64M", True), ("1T", False)):  # Python and NumPy take more than 64M
        assert cli.run(["build", model, "-o", "a.svp.h5", "--memory", memory]) == 0
        said = capfd.readouterr().out
        assert ("MB were held, more than the 67 of --memory" in said) is is_more, said


def test_leaving_at_once_loses_no_output() -> None:
    code = "import atexit, sys; from svprep import cli; atexit.register(print, 'at exit'); "
    code += "sys.argv = ['svprep', '--version']; cli.main()"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[1:] == ["at exit"]
    assert done.stdout.startswith("svprep ")


def test_every_code_is_explained(capfd: pytest.CaptureFixture[str]) -> None:
    from svprep.cache.checks import CHECKS
    from svprep.validate import DEEP_CHECKS

    codes = [f"D{int(c)}" for c in Code] + [*CHECKS, *DEEP_CHECKS]
    assert len(codes) == len(set(codes))
    for code in codes:
        assert cli.run(["validate", "--explain", code]) == 0
        assert capfd.readouterr().out.startswith(code)


def test_our_bug_ends_in_70_and_says_where_the_log_is(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def fail(*_args: object, **_options: object) -> None:
        raise ZeroDivisionError("one by none")

    monkeypatch.setattr(pipeline, "build", fail)
    assert cli.run(["build", "x.obj"]) == 70
    err = capfd.readouterr().err
    assert err.count("\n") == 1
    log = Path(err.rsplit("log: ", 1)[1].strip())
    assert "one by none" in log.read_text()

    def break_invariant(*_args: object, **_options: object) -> None:
        raise InternalError("an edge has no face")

    monkeypatch.setattr(pipeline, "build", break_invariant)
    assert cli.run(["build", "x.obj"]) == 70
    assert "an edge has no face" in capfd.readouterr().err


def test_interrupted_ends_in_130_and_leaves_the_older_cache(tmp_path: Path) -> None:
    model = str(CONFORMANCE / "clean_cube.obj")
    assert svprep("build", model, "-o", "a.svp.h5").returncode == 0
    before = Path("a.svp.h5").read_bytes()
    slow = (
        "import os, signal, threading\n"
        "from svprep import cli, tiles\n"
        # Ignored from the start in a shell's background.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def weld(*args):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    threading.Event().wait(10)\n"
        "tiles.weld = weld\n"
        f"raise SystemExit(cli.run(['build', {model!r}, '-o', 'a.svp.h5', '--full']))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", slow],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 130
    assert done.stderr == "svprep: interrupted\n"
    assert Path("a.svp.h5").read_bytes() == before
    assert os.listdir(tmp_path) == ["a.svp.h5"]


def shell(line: str) -> subprocess.CompletedProcess:
    """Run a shell line in which ``svprep`` is this one."""
    function = f'svprep() {{ "{sys.executable}" -m svprep "$@"; }}; '
    return subprocess.run(
        ["bash", "-c", function + line],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_output_that_cannot_be_written_is_one_line() -> None:
    assert cli.run(["build", str(CONFORMANCE / "clean_cube.obj"), "-o", "a.svp.h5"]) == 0
    full = shell("svprep info a.svp.h5 > /dev/full")
    assert (full.returncode, full.stdout) == (1, "")
    assert "No space left on device" in full.stderr
    assert full.stderr.count("\n") == 1
    model = CONFORMANCE / "open_shell.obj"
    silent = shell(f"svprep build {model} -o b.svp.h5 2>&-; svprep build gone.obj 2>&-")
    assert silent.returncode == 1
    assert "D302" in silent.stdout
    assert shell(f"svprep build {model} -o c.svp.h5 >&-").returncode == 0


def test_a_reader_that_goes_away_is_no_error() -> None:
    assert cli.run(["build", str(CONFORMANCE / "clean_cube.obj"), "-o", "a.svp.h5"]) == 0
    piped = shell("svprep info a.svp.h5 | sleep 0; echo ${PIPESTATUS[0]}")
    assert piped.stdout == "0\n"
    assert piped.stderr == ""
    assert cli.run(["build", str(CONFORMANCE / "clean_cube.obj"), "-o", "a.svp.h5"]) == 0


def test_progress_shows_on_a_terminal_only() -> None:
    model = str(CONFORMANCE / "clean_cube.obj")
    quiet = svprep("build", model, "-o", "a.svp.h5", "--json")
    assert quiet.stderr == ""
    leader, follower = pty.openpty()
    shown = subprocess.Popen(
        [sys.executable, "-m", "svprep", "build", model, "-o", "a.svp.h5", "--json"],
        env={**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm"},
        stdout=subprocess.PIPE,
        stderr=follower,
    )
    out, _ = shown.communicate()
    os.close(follower)
    told = os.read(leader, 100_000)
    os.close(leader)
    assert json.loads(out)["faces"] == 12
    assert b"\x1b[" in told


def test_version_and_bare_call() -> None:
    assert svprep("--version").stdout.startswith("svprep ")
    for arguments in ([], ["-h"], ["--help"]):
        shown = svprep(*arguments)
        assert shown.returncode == 0
        assert shown.stdout.startswith("Usage: svprep")
        assert shown.stderr == ""


def test_reports_list_objects_defects_and_source_faces(
    capfd: pytest.CaptureFixture[str],
) -> None:
    model = str(CONFORMANCE / "three_faces_on_edge.obj")
    assert cli.run(["build", model, "--report", "r.json"]) == 0
    entries = json.loads(Path("r.json").read_text())["objects"]
    found = {f["defect"]: f for e in entries for f in e["findings"]}
    assert found["NONMANIFOLD_EDGE"]["count"] == 4
    faces = found["NONMANIFOLD_EDGE"]["source_faces"]
    assert faces == sorted(set(faces))
    assert len(faces) >= 3
    assert cli.run(["build", str(CITY), "--report", "r.csv"]) == 0
    with open("r.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len({row["object"] for row in rows}) == 300
    flipped = [row for row in rows if row["defect"] == "FLIPPED_FACE"]
    assert sum(int(row["count"]) for row in flipped) == 101
    for row in rows:
        if row["defect"] in ("FLIPPED_FACE", "OPEN_SHELL", "DUPLICATE_FACE"):
            assert row["source_faces"], row
    clean = [row for row in rows if not row["defect"]]
    assert clean
    assert all(row["count"] == "" for row in clean)
    capfd.readouterr()


def test_several_inputs_make_one_cache(capfd: pytest.CaptureFixture[str]) -> None:
    models = [str(CONFORMANCE / name) for name in ("clean_cube.obj", "clean_tetrahedron.obj")]
    assert cli.run(["build", *models, "-o", "both.svp.h5", "--json"]) == 0
    built = json.loads(capfd.readouterr().out)
    assert (built["objects"], built["faces"], built["solid"]) == (2, 16, 2)


def test_nothing_of_the_users_is_overwritten(capfd: pytest.CaptureFixture[str]) -> None:
    model = str(CONFORMANCE / "clean_cube.obj")
    with h5py.File("mine.h5", "w") as file:
        file["x"] = 1
    Path("city.json").write_text('{"type": "CityJSON"}')
    Path("linked.csv").write_bytes(Path(model).read_bytes())
    os.link("linked.csv", "linked.obj")
    os.mkfifo("pipe.csv")
    kept = {name: Path(name).read_bytes() for name in ("mine.h5", "city.json", "linked.obj")}
    for arguments in (
        [model, "-o", "mine.h5"],
        [model, "-o", "a.svp.h5", "--report", "city.json"],
        ["linked.obj", "-o", "a.svp.h5", "--report", "linked.csv"],
        [model, "-o", "a.svp.h5", "--report", "pipe.csv"],
    ):
        assert cli.run(["build", *arguments]) == 1
        assert capfd.readouterr().err.count("\n") == 1
    assert {name: Path(name).read_bytes() for name in kept} == kept
    assert not Path("a.svp.h5").exists()
    for _ in range(2):  # our own report and cache may be replaced
        assert cli.run(["build", model, "-o", "a.svp.h5", "--report", "r.csv"]) == 0
        assert cli.run(["build", model, "-o", "a.svp.h5", "--report", "r.json"]) == 0


def test_names_cannot_steer_a_terminal_or_a_spreadsheet() -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\no =1+2\nf 1 2 3\no caf\xe9\nf 1 2 3\no \x1b]0;x\x07\n"
    Path("names.obj").write_text(text, encoding="utf-8")
    line = "LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 svprep build names.obj --report r.csv"
    done = shell(line)
    assert (done.returncode, done.stderr) == (0, "")
    assert "\x1b" not in done.stdout
    with open("r.csv", newline="", encoding="utf-8") as file:
        assert {row["object"] for row in csv.DictReader(file)} == {"'=1+2", "caf\xe9"}


def test_the_first_build_runs_nothing_from_the_current_folder() -> None:
    for name in ("numba.py", "numpy.py", "svprep.py"):
        Path(name).write_text("open('ran', 'w')")
    program = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from svprep.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-P", "-c", program, "build", str(CONFORMANCE / "clean_cube.obj")],
        env={**os.environ, "NUMBA_CACHE_DIR": str(Path.cwd() / "kernels")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not Path("ran").exists()
