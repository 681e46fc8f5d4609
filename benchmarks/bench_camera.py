"""Error of detected line points against the analytic line, and the time of a field, under stated disturbances.

    python benchmarks/bench_camera.py [--fields 200] [--json FILE]

The line is a sine of 50 mm amplitude and 0.4 m length (least radius 81 mm), 3 mm wide, gray 40 on 200 with a soft edge
of 1 mm; the tool is over it with errors of ±3 mm and ±2° and looks along it, the prediction is ±1 mm off. Errors:
distance of each point that is used from the analytic line. Times: medians of the calling thread's processor time.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from sensing.camera.camera_model import CalibrationError, CameraModel
from sensing.camera.hand_eye import Observation, calibrate, calibration_poses
from sensing.camera.line_detection import LineField, PredictedLine, detect_line, search_windows
from sensing.camera.line_polynomial import fit_line_polynomial
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.surface import DrawnLine, Feature, Texture, paint

AHEAD = np.linspace(0.02, 0.11, 5)
QUIET = CameraSettings(exposure=0.0, noise=0.0, jitter=0.0, stamp_noise=0.0)
UP = np.array([0.0, 0.0, 1.0])


def sine(features: tuple[Feature, ...] = (), amplitude: float = 0.05) -> DrawnLine:
    """The line on a surface at the base's height."""
    x = np.arange(0.0, 1.0, 0.0005)
    xy = np.column_stack([x, amplitude * np.sin(2 * np.pi * x / 0.4)])
    return DrawnLine.from_plane_points(xy, pin.SE3.Identity(), features=features)


def clutter(rng: np.random.Generator) -> tuple[Feature, ...]:
    """Every 0.2 m a crossing line, a parallel piece, a scratch, glare, a shade and a gap."""
    found = []
    for start in np.arange(0.0, 1.0, 0.2):
        found += [
            Feature("crossing", start + 0.10, length=0.1, angle=rng.uniform(0.4, 2.7)),
            Feature("parallel", start + 0.18, length=0.04, offset=rng.choice([-1, 1]) * rng.uniform(0.008, 0.015)),
            Feature("scratch", start + 0.05, offset=rng.uniform(-0.01, 0.01), angle=rng.uniform(-1, 1), width=0.001,
                    gray=float(rng.choice([60.0, 240.0]))),
            Feature("glare", start + 0.13, offset=rng.uniform(-0.008, 0.008), length=0.03),
            Feature("shade", start + 0.22, length=0.06),
            Feature("gap", start + 0.15, length=0.02),
        ]  # fmt: skip
    return tuple(f for f in found if f.at < 0.98)


@dataclass
class Case:
    """One line of the table."""

    name: str
    settings: CameraSettings = QUIET
    camera: CameraModel = field(default_factory=CameraModel.default)
    believed: CameraModel | None = None
    speed: float = 0.0
    late: float = 0.0
    cluttered: bool = False


def over(line: DrawnLine, s: float, aside: float, turn: float) -> pin.SE3:
    """The tool at arc length ``s``, looking along the line."""
    # The polyline's own tangent jumps from segment to segment; a tool's does not.
    (before, after), _ = line.at(np.array([s - 0.005, s + 0.005]))
    tangent = (after - before) / np.linalg.norm(after - before)
    rotation = np.column_stack([tangent, np.cross(-UP, tangent), -UP])
    on_line = pin.SE3(rotation, line.at(np.array([s]))[0][0])
    return on_line * pin.SE3(pin.rpy.rpyToMatrix(0, 0, turn), np.array([0.0, aside, 0.0]))


def fields(
    line: DrawnLine, texture: Texture, case: Case, count: int
) -> Iterator[tuple[Array, LineField, float, float]]:
    """Errors of the used points, what was detected, and the times of rendering and of sensing."""
    rng = np.random.default_rng(1)
    believed = case.believed or case.camera
    with RenderedCamera(case.camera, line, case.settings, rng, texture) as camera:
        for i in range(count + 3):
            s = rng.uniform(0.02, line.length - 0.15)
            aside, turn = rng.uniform(-0.003, 0.003), radians(rng.uniform(-2, 2))
            t = case.settings.phase + i / case.settings.rate

            def pose_at(time_: float, s: float = s, t: float = t, aside: float = aside, turn: float = turn) -> pin.SE3:
                return over(line, s + case.speed * (time_ - t), aside, turn)

            points, tangents = line.at(s + AHEAD)
            off = rng.uniform(-0.001, 0.001) * np.cross(UP, tangents)
            told = pose_at(t + case.late)
            prediction = PredictedLine.from_base(points + off, tangents, UP, told, 0.001)
            begin = time.thread_time()
            windows = search_windows(believed, prediction)
            middle = time.thread_time()
            taken = camera.windows(t, pose_at, windows)
            rendered = time.thread_time()
            found = detect_line(taken, believed, prediction)
            end = time.thread_time()
            if i >= 3:
                used = found.points_tcp[found.used] @ told.rotation.T + told.translation
                error = line.distance(used) if len(used) and found.seen else np.empty(0)
                yield error, found, rendered - middle, end - rendered + middle - begin


def accuracy(count: int) -> list[dict[str, Any]]:
    """The table of errors."""
    c320, c640 = CameraModel.default(), CameraModel.default(640, 480)
    plain = replace(c320, distortion=np.zeros(5))
    usual = replace(QUIET, exposure=0.002, noise=3.0)
    cases = [
        Case("nothing"), Case("nothing, 640×480", camera=c640), Case("nothing, no lens distortion", camera=plain),
        *(Case(f"gray noise {n}", replace(QUIET, noise=n)) for n in (2.0, 5.0, 10.0)),
        Case("2 ms exposure at 0.7 m/s, noise 3", usual, speed=0.7),
        Case("the same, 640×480", usual, camera=c640, speed=0.7),
        Case("time stamp wrong by 0.1 ms at 0.7 m/s", QUIET, speed=0.7, late=1e-4),
        Case("time stamp wrong by 1 ms at 0.7 m/s", QUIET, speed=0.7, late=1e-3),
        Case("crossings, parallel lines, scratches, glare, shade, gaps, noise 3", usual, cluttered=True),
        Case("lens distortion k1 = -0.2 ignored", believed=plain),
        *(Case(f"calibration: {name}", believed=c320.perturbed(**change)) for name, change in (
            ("roll 0.1°", {"roll": radians(0.1)}), ("pitch 0.1°", {"pitch": radians(0.1)}),
            ("yaw 0.1°", {"yaw": radians(0.1)}), ("height 1 mm", {"height": 0.001}),
            ("focal length 0.1 %", {"focal": 0.001}), ("principal point 0.5 px", {"principal_u": 0.5}),
            ("k1 by 0.01", {"k1": 0.01}))),
    ]  # fmt: skip
    clean, dirty = sine(), sine(clutter(np.random.default_rng(5)))
    painted = {False: paint(clean), True: paint(dirty)}
    rows = []
    for case in cases:
        line = dirty if case.cluttered else clean
        results = list(fields(line, painted[case.cluttered], case, count))
        error = 1e6 * np.concatenate([r[0] for r in results])
        rows.append({
            "disturbance": case.name, "mean_um": float(error.mean()), "p95_um": float(np.percentile(error, 95)),
            "max_um": float(error.max()), "wrong_percent": float(100 * np.mean(error > 200)),
            "points_per_field": len(error) / count, "seen_percent": 100 * float(np.mean([r[1].seen for r in results])),
        })  # fmt: skip
    return rows


def times(count: int) -> list[dict[str, Any]]:
    """Rendering and sensing of a field in the default scene's settings, and with more samples."""
    line = sine()
    texture = paint(line)
    rows = []
    for name, settings, camera in (
        ("default: 2 ms exposure in 3 pictures, 2×2 samples", CameraSettings(), CameraModel.default()),
        ("one picture, 2×2 samples", replace(CameraSettings(), sub_exposures=1), CameraModel.default()),
        ("3 pictures, 4×4 samples", replace(CameraSettings(), supersampling=4), CameraModel.default()),
        ("default at 640×480", CameraSettings(), CameraModel.default(640, 480)),
    ):
        results = list(fields(line, texture, Case(name, settings, camera, speed=0.7), count))
        rows.append({"part": f"five windows rendered, {name}", "ms": 1e3 * float(np.median([r[2] for r in results]))})
        if name.startswith("default"):
            rows.append({"part": f"windows predicted and line detected, {name}",
                         "ms": 1e3 * float(np.median([r[3] for r in results]))})
    s, d = AHEAD, 1e-5 * np.arange(5.0)
    rows.append({"part": "polynomial through five points", "ms": _time(lambda: fit_line_polynomial(s, d, d + 1e-5))})
    rng = np.random.default_rng(0)
    with RenderedCamera(CameraModel.default(), line, QUIET, rng, texture) as camera:
        rows.append({"part": "whole image 320×240, 2×2 samples",
                     "ms": _time(lambda: camera.frame(over(line, 0.2, 0.0, 0.0)), 5)})
    return rows


def _time(function: Callable[[], object], repeats: int = 200) -> float:
    taken = []
    for _ in range(repeats):
        begin = time.thread_time()
        function()
        taken.append(1e3 * (time.thread_time() - begin))
    return float(np.median(taken))


def calibration(seeds: int) -> list[dict[str, Any]]:
    """A camera mounted by hand before and after calibration from the line, with exact poses and with wrong ones."""
    error = CalibrationError(roll=radians(0.3), pitch=radians(0.3), yaw=radians(0.3), height=0.001, lateral=0.0005,
                             focal=0.003, principal_point=1.0, distortion=0.01)  # fmt: skip
    line = sine(amplitude=0.03)
    texture = paint(line)
    x, y = np.meshgrid(AHEAD, np.linspace(-0.02, 0.02, 5))
    probe = np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()])
    reference = line.points + np.array([0.004, 0.006, 0.0])
    rows = []
    for name, spread in (("poses exact", 0.0), ("poses wrong by 0.1 mm and 0.1 mrad (σ)", 1e-4)):
        before, after = [], []
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            believed = CameraModel.default()
            true = believed.perturbed(**error.signed(rng))
            seen = []
            with RenderedCamera(true, line, CameraSettings(), rng, texture) as camera:
                centre, tangent = (a[0] for a in line.at(np.array([0.5 * line.length])))
                for i, pose in enumerate(calibration_poses(centre, tangent, UP, 0.065)):
                    s = line.nearest(pose.act(np.array([[0.065], [0.0], [0.0]])).T).s
                    points, tangents = line.at(s + np.linspace(-0.07, 0.07, 9))
                    prediction = PredictedLine.from_base(points + [0.004, 0.006, 0.0], tangents, UP, pose, 0.006)  # noqa: RUF005
                    found = detect_line(camera.windows(0.005 + 0.02 * i, lambda t, pose=pose: pose,  # type: ignore[misc]
                                                       search_windows(believed, prediction)), believed, prediction)
                    told = pose * pin.SE3(pin.exp3(spread * rng.standard_normal(3)), spread * rng.standard_normal(3))
                    if found.seen:
                        seen.append(Observation(told, found.pixels[found.used], found.sigma[found.used]))
            result = calibrate(believed, seen, reference, UP)
            for camera_, errors in ((believed, before), (result.camera, after)):
                errors.append(float(np.abs((camera_.on_plane(true.project_tool(probe), UP, 0.0) - probe)[:, 1]).mean()))
        rows.append({"calibration": name, "before_um": 1e6 * float(np.mean(before)),
                     "after_um": 1e6 * float(np.mean(after)), "worst_um": 1e6 * max(after)})
    return rows


def calibration_in_scenes(seeds: int) -> list[dict[str, Any]]:
    """The simulated arm driven over the line of a scene, all world effects on; lateral error left."""
    from ideal_robot.elasticity.observer import GearDeflection
    from scenes import load_scene
    from scenes.line.calibration import calibrate_by_moving
    from scenes.line.cell import set_up
    from scenes.models import model_for
    from sensing.camera.line_detection import DetectionSettings
    from sim.arm.arm import SimulatedArm

    x, y = np.meshgrid(AHEAD, np.linspace(-0.02, 0.02, 5))
    probe = np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()])
    rows = []
    for name in ("line", "gap", "corner"):
        for deflected in (True, False):
            before, after, taken = [], [], []
            for seed in range(1, seeds + 1):
                cell = set_up(load_scene(name).changed(seed=seed))
                bending = GearDeflection(model_for(cell.scene, cell.robot), cell.world.t_ipo) if deflected else None
                with (SimulatedArm(cell.robot, cell.world, cell.noise, cell.follower.q_start) as arm,
                      RenderedCamera(cell.true_camera, cell.line, CameraSettings(), cell.camera_noise) as camera):
                    begin = time.process_time()
                    result = calibrate_by_moving(cell.robot, cell.reference, cell.camera, arm, camera, bending,
                                                 0.5 * cell.reference.length, DetectionSettings(), cell.detector)
                    taken.append(time.process_time() - begin)
                for camera_, errors in ((cell.camera, before), (result.camera, after)):
                    back = camera_.on_plane(cell.true_camera.project_tool(probe), UP, 0.0)
                    errors.append(float(np.abs((back - probe)[:, 1]).mean()))
            rows.append({"scene": f"{name}, gear deflection {'from the model' if deflected else 'ignored'}",
                         "before_um": 1e6 * float(np.mean(before)), "after_um": 1e6 * float(np.mean(after)),
                         "worst_um": 1e6 * max(after), "seconds": float(np.median(taken))})
    return rows


def show(rows: list[dict[str, Any]]) -> None:
    """Prints a table with the keys as titles."""
    keys = list(rows[0])
    first = max(len(str(row[keys[0]])) for row in rows)
    print(f"{keys[0]:{first}}  " + "  ".join(f"{key:>16}" for key in keys[1:]))
    for row in rows:
        print(f"{row[keys[0]]:{first}}  " + "  ".join(f"{row[key]:16.3g}" for key in keys[1:]))
    print()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fields", type=int, default=200, help="fields per line of the table")
    parser.add_argument("--json", type=Path, help="also writes the tables here")
    arguments = parser.parse_args()
    tables = {"accuracy": accuracy(arguments.fields), "times": times(arguments.fields),
              "calibration": calibration(max(arguments.fields // 20, 2)),
              "calibration_in_scenes": calibration_in_scenes(max(arguments.fields // 60, 1))}
    for rows in tables.values():
        show(rows)
    if arguments.json:
        arguments.json.write_text(json.dumps(tables, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
