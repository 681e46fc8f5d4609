"""``ideal-robot detect`` on files, folders and videos, and on what is none."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from ideal_robot.signals.export import write_rerun
from ideal_robot.signals.recording import Recording
from scenes.detection import pictures
from scenes.kind import KINDS
from scenes.scene_file import library, load_scene
from scenes.scene_files.shape import STEP, Shape
from scenes.schema import catalogue, commented_scene, json_schema, keys_pages, scene_keys, world_keys
from sensing.camera.video_capture import opened_usb
from tests.ideal_robot.diagnosis.poor_recording import URDF, poor_recording
from tests.sensing.camera.synthetic import drawn_line, film
from tests.sources import ROOT


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    where = tmp_path / "cell"
    where.mkdir()
    cv2.imwrite(str(where / "a.png"), drawn_line(seed=1)[0])
    cv2.imwrite(str(where / "b.png"), np.full((240, 320), 128, np.uint8))
    return where


def test_a_folder_gives_points_and_reasons(program, folder: Path, tmp_path: Path) -> None:
    done = program("detect", "cell", "--json", "line.json", "--out", "out")
    assert done.code == 0, done.err
    first, second = json.loads((tmp_path / "line.json").read_text())["pictures"]
    assert first["found"]
    assert first["polarity"] == "dark"
    assert abs(first["width_px"] - 8.0) < 1.0
    assert first["sigma_px"] < 0.2
    assert sum(point["confidence"] > 0.5 for point in first["points"]) > 10
    assert not second["found"]
    assert second["reason"]
    assert "data:image/png" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(("words", "code", "said"), [
    ((), 1, ""), (("--kind", "rope"), 2, "rope"), (("--near", "here"), 2, "--near")])
def test_pictures_without_a_line_and_unknown_kinds_or_places_end_with_their_code(
        program, words: tuple[str, ...], code: int, said: str, folder: Path) -> None:
    done = program("detect", "cell/b.png", *words, "--out", "out")
    assert done.code == code
    assert said in done.err


def test_what_is_no_picture_is_a_row_and_the_others_go_on(program, folder: Path, tmp_path: Path) -> None:
    (folder / "broken.png").write_bytes(b"no picture at all")
    done = program("detect", "cell", "cell/a.png", "nowhere.png", "--json", "line.json", "--out", "out")
    assert done.code == 0, done.err
    rows = json.loads((tmp_path / "line.json").read_text())["pictures"]
    assert [row["picture"] for row in rows] == ["a.png", "b.png", "broken.png", "a.png", "nowhere.png"]
    assert [row["found"] for row in rows] == [True, False, False, True, False]
    assert "nowhere.png" in rows[4]["reason"]
    assert rows[0]["probability"] > 0.65 > rows[1]["probability"]
    assert len(rows[0]["curve"]) > len(rows[0]["points"]) == 15
    assert [len(row["pieces"]) for row in rows] == [1, 0, 0, 1, 0]
    done = program("detect", "cell/broken.png", "nowhere.png", "--out", "none")
    assert done.code == 2
    assert not (tmp_path / "none").exists()


def test_frames_of_a_video(program, tmp_path: Path) -> None:
    path = film(tmp_path / "line.avi", (drawn_line(seed=seed)[0] for seed in range(4)), 10.0)
    assert [name for name, _ in pictures(str(path), every=2)] == ["frame 0", "frame 2"]
    done = program("detect", "line.avi", "--json", "line.json", "--out", "out")
    assert done.code == 0, done.err
    states = [picture["state"] for picture in json.loads((tmp_path / "line.json").read_text())["pictures"]]
    assert states == ["found", *["followed"] * 3]


@pytest.mark.parametrize("mounted", ["tool", pytest.param("cell", marks=pytest.mark.slow)])
def test_a_camera_is_located_by_a_board(program, mounted: str, tmp_path: Path) -> None:
    """Pictures of a board drawn through a known camera from random poses of the tool."""
    rng = np.random.default_rng(1)
    K = np.array([[700.0, 0.0, 319.5], [0.0, 700.0, 239.5], [0.0, 0.0, 1.0]])
    X = pin.SE3(pin.exp3(rng.uniform(-1.0, 1.0, 3)), rng.uniform(-0.2, 0.2, 3))
    Y = pin.SE3(pin.exp3(rng.uniform(-1.0, 1.0, 3)), rng.uniform(-0.5, 0.5, 3))
    side, columns, rows = 40, 7, 5
    sheet = np.full(((rows + 3) * side, (columns + 3) * side), 235.0)
    squares = np.indices((rows + 1, columns + 1)).sum(axis=0) % 2
    sheet[side:-side, side:-side] = np.kron(squares, np.ones((side, side))) * 205.0 + 30.0
    lines = ["picture,x,y,z,qx,qy,qz,qw"]
    for k in range(12):
        R = pin.exp3(rng.uniform(-0.5, 0.5, 3))
        T = pin.SE3(R, np.array([0.0, 0.0, 0.45]) - R @ np.array([0.06, 0.04, 0.0]))
        # A pixel of the sheet is half a millimetre; the board's first inner corner is its frame's origin.
        first = -5e-4 * (2 * side - 0.5)
        from_sheet = np.array([[5e-4, 0.0, first], [0.0, 5e-4, first], [0.0, 0.0, 1.0]])
        H = K @ np.column_stack([T.rotation[:, :2], T.translation]) @ from_sheet
        picture = cv2.warpPerspective(sheet, H, (640, 480), flags=cv2.INTER_AREA, borderValue=128.0)
        noisy = cv2.GaussianBlur(picture, (0, 0), 0.8) + rng.normal(0.0, 2.0, picture.shape)
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.clip(noisy, 0, 255).astype(np.uint8))
        mover = Y * T.inverse() * X.inverse()
        pose = mover if mounted == "tool" else mover.inverse()
        lines.append(",".join([f"{k}.png", *map(str, pin.SE3ToXYZQUAT(pose))]))
    (tmp_path / "poses.csv").write_text("\n".join(lines))
    done = program("calibrate", "poses.csv", "--board", f"{columns}x{rows}", "--square", "20", "--mounted", mounted,
                   "--json", "camera.json")
    assert done.code == 0, done.err
    found = json.loads((tmp_path / "camera.json").read_text())
    off = np.array(found["camera"]["position"]) - X.translation
    sigma = np.sqrt(np.diag(found["camera_covariance"]))[:3]
    assert np.linalg.norm(off) < 2e-3
    assert np.linalg.norm(sigma) < 2e-3
    assert abs(found["intrinsics"]["K"][0][0] / 700.0 - 1.0) < 5e-3
    assert sum(found["pictures"].values()) >= 10


@pytest.mark.parametrize(("words", "said"), [
    ((), "--board"), (("--board", "9"), "--board"), (("--board", "9x6", "--mounted", "roof"), "mounted"),
    (("--board", "9x6"), "quaternion")])
def test_what_locates_no_camera_is_said(program, words: tuple[str, ...], said: str, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.full((100, 100), 128, np.uint8))
    last = 0 if said == "quaternion" else 1
    (tmp_path / "poses.csv").write_text(f"picture,x,y,z,qx,qy,qz,qw\na.png,0,0,0,0,0,0,{last}")
    done = program("calibrate", "poses.csv", *words, "--json", "camera.json")
    assert done.code == 2
    assert said in done.err
    assert not (tmp_path / "camera.json").exists()


@pytest.mark.parametrize("source", ["missing.png", "nowhere", "empty", "broken.png", "broken.avi"])
def test_what_cannot_be_read_is_said(source: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("broken.png", "broken.avi"):
        (tmp_path / name).write_bytes(b"no picture at all")
    with pytest.raises(InputError):
        list(pictures(str(tmp_path / source)))


@pytest.mark.parametrize("number", ["9" * 20, "²"])
def test_a_number_that_no_camera_has_is_said(number: str) -> None:
    with pytest.raises(InputError, match="nor the number of a camera"):
        list(pictures(number))
    with pytest.raises(InputError, match="expected the number of a camera"):
        opened_usb(number, 0.0)


def test_a_small_file_of_a_huge_picture_is_refused_before_it_is_unpacked(tmp_path: Path,
                                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    cv2.imwrite(str(tmp_path / "huge.png"), np.zeros((20_000, 10_000), np.uint8))
    cv2.imwrite(str(tmp_path / "large.png"), np.zeros((8_100, 8_000), np.uint8))
    monkeypatch.setattr(cv2, "imread", lambda *_: pytest.fail("unpacked"))
    for name in ("huge.png", "large.png"):
        with pytest.raises(InputError, match="64 megapixels"):
            next(pictures(str(tmp_path / name)))


# ``ideal-robot export`` writes what its options say, and nothing for names that cannot be.

@pytest.fixture
def recording(tmp_path: Path) -> Path:
    t = 0.012 * np.arange(40.0)
    q = np.random.default_rng(0).normal(size=(40, 3))
    return Recording.from_arrays(t, q=q, tau=q, x=t, y=t, z=t).write(tmp_path / "in.parquet")


def test_several_formats_at_once(program, recording: Path, tmp_path: Path) -> None:
    done = program("export", "in.parquet", "--csv", "o.csv", "--mcap", "o.mcap", "--rosbag2", "bag")
    assert done.code == 0, done.err
    expected = Recording.read(recording).joints("q")
    for name in ("o.csv", "o.mcap", "bag"):
        np.testing.assert_allclose(Recording.read(tmp_path / name).joints("q"), expected, atol=1e-12)


@pytest.mark.parametrize("words", [
    [], ["--csv", "o.txt"], ["--rerun", "o.txt"], ["--mcap", "o.bag"],
    ["--csv", "o.csv", "--rosbag2", "o", "--rerun", "o.txt"],
    pytest.param(["--mcap", "o.mcap", "--csv", "o.csv", "--rerun", "o.rrd"], id="without the extra of one format")])
def test_no_format_or_another_ending_is_refused(program, words: list[str], recording: Path, tmp_path: Path,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert program("export", "in.parquet", *words).code == 2
    assert [entry.name for entry in tmp_path.iterdir()] == ["in.parquet"]


def test_rerun_reads_its_file_back(recording: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs the optional package rerun-sdk")
    path = write_rerun(Recording.read(recording), tmp_path / "o.rrd")
    tool = [sys.executable, "-m", "rerun_cli", "rrd"]
    checked = subprocess.run([*tool, "verify", str(path)], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr
    printed = subprocess.run([*tool, "print", "-v", str(path)], capture_output=True, text=True, check=True).stdout
    for entity in ("/q/1", "/tau/3", "/tool/path", "/tool/now"):
        assert entity in printed


# ``plan-diagnosis`` from files: the motion it writes can be read, and wrong input leaves nothing behind.

OPEN = {"effects": [{"effect": "degressive", "joint": 2, "channel": "tau_2",
                     "indistinguishable_from": ["torque_ripple"]}], "undecided": []}


@pytest.fixture
def files(tmp_path):
    (tmp_path / "arm.urdf").write_text(URDF, encoding="utf-8")
    poor_recording().write(tmp_path / "run.parquet")
    (tmp_path / "open.json").write_text(json.dumps(OPEN), encoding="utf-8")
    return tmp_path


PLAN = ("plan-diagnosis", "run.parquet", "--urdf", "arm.urdf", "--result", "open.json", "--out", "motion.csv")


def test_motion_is_written_and_read(program, files):
    done = program(*PLAN, "--length", "40", "--z-min", "-9", "--json", "plan.json")
    assert done.code == 0, done.err
    plan = json.loads((files / "plan.json").read_text())
    motion = Recording.read(files / "motion.csv")
    assert plan["duration_s"] <= 40.0
    assert len(motion.t) == plan["samples"]
    assert plan["pairs"][0]["sigma"]["planned"] > plan["pairs"][0]["sigma"]["before"]
    assert np.all(np.isfinite(np.column_stack([motion.columns["q_d_1"], motion.columns["q_c_2"]])))


@pytest.mark.parametrize(("change", "length", "field"), [
    ({"effects": [{"effect": "gremlin", "joint": 1}]}, "40", "effects.0.effect"),
    ({"verdict": "none"}, "40", "effects"), ({**OPEN, "recording_hash": "of another one"}, "40", "recording_hash"),
    (OPEN, "1", "length")])
def test_wrong_result_or_length_leaves_nothing(program, files, change, length, field):
    (files / "open.json").write_text(json.dumps(change), encoding="utf-8")
    done = program(*PLAN, "--length", length)
    assert done.code == 2
    assert f"{field}: " in done.err
    assert not (files / "motion.csv").exists()


# Keys of scene files: the commented file can be played, the schema accepts what the program accepts.

EXAMPLES = {"line": "line", "path": "iso9283_1", "force": "force_wave", "clamped": "clamped_kr500_1"}


@pytest.mark.parametrize("kind", sorted(EXAMPLES))
def test_a_commented_file_is_the_example_and_names_every_key(kind: str, tmp_path: Path) -> None:
    text = commented_scene("mine", kind, (library() / f"{EXAMPLES[kind]}.toml").read_text(encoding="utf-8"))
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    scene, shipped = load_scene(path), load_scene(EXAMPLES[kind])
    same = {"name", "title"}
    assert scene.model_dump(exclude=same) == shipped.model_dump(exclude=same)
    for key in scene_keys(kind):
        if key.name not in ("name", "kind", "world"):
            assert re.search(rf"^(# )?{key.name} = ", text, flags=re.M) or key.name in text, key


@pytest.mark.parametrize("kind", sorted(EXAMPLES))
def test_every_commented_default_is_accepted(kind: str, tmp_path: Path) -> None:
    """Taking the # away from keys that have a default changes nothing."""
    example = (library() / f"{EXAMPLES[kind]}.toml").read_text(encoding="utf-8")
    lines = commented_scene("mine", kind, example).splitlines()
    end = lines.index("# [world]")
    uncommented = [line[2:] if re.match(r"# [a-z_0-9]+ = (?!…)", line) else line for line in lines[:end]]
    header = None
    alive = []
    for line in uncommented:
        if re.match(r"# \[+[a-z_.]+\]+$", line):
            header = line
        elif re.match(r"\[", line):
            header = None
        # A table that is only a comment keeps its keys as comments.
        alive.append(line if header is None or line.startswith("#") or not line else f"# {line}")
    path = tmp_path / "mine.toml"
    path.write_text("\n".join(alive), encoding="utf-8")
    scene, shipped = load_scene(path), load_scene(EXAMPLES[kind])
    assert scene.model_dump(exclude={"name", "title"}) == shipped.model_dump(exclude={"name", "title"})


def test_the_pages_name_every_kind_and_key() -> None:
    pages = keys_pages()
    index = (ROOT / "docs" / "scene_keys.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\]\((scene_keys/\w+\.md)\)", index)) == set(pages)
    for kind in KINDS.names():
        text = pages[f"scene_keys/{kind}.md"]
        text += "".join(pages[f"scene_keys/{page}"] for page in re.findall(r"\]\((\w+\.md)\)", text))
        assert all(f"`{key.name}`" in text for key in scene_keys(kind))
        assert "Annotated" not in pages[f"scene_keys/{kind}.md"]
    assert all(key.meaning for key in world_keys() if key.name != "robot"), \
        [key.name for key in world_keys() if not key.meaning]


def test_the_schema_is_one_and_has_the_limits() -> None:
    schema = json_schema("line")
    json.dumps(schema)
    assert schema["properties"]["speed"]["exclusiveMinimum"] == 0
    assert "stamps are wrong" in schema["properties"]["stamp_estimate"]["description"]
    assert schema["additionalProperties"] is False


@pytest.mark.parametrize("what", ["scenes", "robots", "methods", "effects", "detectors", "interfaces", "keys"])
def test_lists_have_a_word_in_every_row(what: str) -> None:
    columns, rows = catalogue(what)
    assert rows
    assert all(len(row) == len(columns) and row[0] is not None for row in rows)


def test_new_writes_once(program, tmp_path: Path) -> None:
    assert program("new", "seam").code == 0
    assert load_scene("seam").kind == "line"
    for words, message in ((["seam"], "already"), (["../up"], "letters"), (["other", "--kind", "dance"], "expected")):
        done = program("new", *words)
        assert done.code == 2
        assert message in done.err
    assert [entry.name for entry in tmp_path.iterdir()] == ["seam.toml"]


# Shapes of lines: lengths and roundings known in closed form, and clear words for broken ones.

def _length(curve: np.ndarray) -> float:
    return float(np.sum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))


@given(st.floats(0.05, 2.0), st.floats(-1.0, 1.0))
def test_points_are_evenly_spaced_and_start_at_the_origin(length: float, slope: float) -> None:
    curve = Shape(formula=f"{slope}*x + 0.1", length=length).curve()
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    assert np.allclose(curve[0], 0.0)
    assert np.allclose(steps, steps[0], rtol=1e-6)
    assert abs(steps[0] - STEP) < 0.1 * STEP
    assert _length(curve) == pytest.approx(length * np.hypot(1, slope), rel=1e-9)


def test_rounded_corner_replaces_the_tangents_by_a_quarter_circle() -> None:
    curve = Shape(points=[(0, 0), (0.5, 0), (0.5, 0.4)], corner_radius=0.1).curve()
    assert _length(curve) == pytest.approx(0.9 - 2 * 0.1 + np.pi / 2 * 0.1, abs=1e-4)
    centre = np.array([0.4, 0.1])
    distance = np.linalg.norm(curve - centre, axis=1)
    assert distance.min() == pytest.approx(0.1, abs=1e-4)


def test_svg_is_scaled_to_the_length_asked_for_and_y_points_up() -> None:
    curve = Shape(svg="M 0 0 L 100 0 L 100 -50", svg_length=0.6).curve()
    assert _length(curve) == pytest.approx(0.6, rel=1e-3)
    assert curve[-1] == pytest.approx([0.4, 0.2], abs=1e-3)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"svg": "M 0 0 Q zz"}, "broken SVG path"),
        ({"svg": ""}, "draws nothing"),
        ({"svg": "M 0 0 L 100 0 M 200 0 L 300 0"}, "several parts"),
        ({"svg": "not_there.svg"}, "no such SVG file"),
        ({"formula": "0.1*sinn(x)", "length": 1.0}, "cannot be evaluated"),
        ({"formula": "1/(x-x)", "length": 1.0}, "not finite"),
        ({"points": [(0, 0), (0, 0)]}, "two different points"),
        ({"points": [(0, 0), (0.1, 0), (0.1, 0.1)], "corner_radius": 0.2}, "too close"),
        ({"formula": "0", "length": 0.001}, "shorter than 10 mm"),
    ],
)
def test_broken_shapes_are_told_in_one_clear_line(keys: dict, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        Shape(**keys).curve()
    assert caught.value.field is not None
    assert "\n" not in str(caught.value)
