"""Line points against the analytic line, calibration from the line, and the time of a field, under stated disturbances.

The line is a sine of 50 mm amplitude and 0.4 m length (least radius 81 mm), 3 mm wide, gray 40 on 200 with a soft edge
of 1 mm; the tool is over it with errors of ±3 mm and ±2° and looks along it, the prediction is ±1 mm off. Errors:
distance of each point that is used from the analytic line. Times: medians of the calling thread's processor time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from math import radians

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import GearDeflection
from scenes.camera_calibration import calibrate_by_moving
from scenes.commands.common import whole_numbers
from scenes.line.cell import set_up
from scenes.models import model_for
from scenes.online.line_known import SeenBefore
from scenes.scene_files.line_scene import LineScene
from sensing.camera.camera_model import CalibrationError, CameraModel
from sensing.camera.detector import DETECTORS
from sensing.camera.hand_eye import HandEye, Observation, calibrate, calibration_poses
from sensing.camera.line_detection import DetectionSettings, PredictedLine, detect_line, search_windows
from sensing.camera.line_polynomial import fit_line_polynomial
from sim.arm.arm import SimulatedArm
from sim.camera.camera import CameraSettings, RenderedCamera
from sim.camera.surface import DrawnLine, Feature
from studies.report import head, row, scene_of, used
from tests.sensing.camera.test_hand_eye import measuring_error

AHEAD = np.linspace(0.02, 0.11, 5)
UP = np.array([0.0, 0.0, 1.0])
QUIET = CameraSettings(exposure=0.0, noise=0.0, jitter=0.0, stamp_noise=0.0)
USUAL = replace(QUIET, exposure=0.002, noise=3.0)
REAL = replace(USUAL, noise=0.5, full_well=10_000.0, mosaic=True, defocus_px=0.6, vignetting=0.3, jpeg_quality=92)
"""As the camera of the scene `real_camera`."""
REDRAWN, WARMING = 250, 3
"""Fields after which a line is drawn anew, and fields before those whose time counts."""
Drawn = Callable[[np.random.Generator], DrawnLine]


def _sine(features: tuple[Feature, ...] = (), amplitude: float = 0.05) -> DrawnLine:
    """The line on a surface at the base's height."""
    x = np.arange(0.0, 1.0, 0.0005)
    xy = np.column_stack([x, amplitude * np.sin(2 * np.pi * x / 0.4)])
    return DrawnLine.from_plane_points(xy, pin.SE3.Identity(), features=features)


def _clean(rng: np.random.Generator) -> DrawnLine:
    return _sine()


def _clutter(rng: np.random.Generator) -> tuple[Feature, ...]:
    """Every 0.2 m a crossing line, a parallel piece, a scratch, glare, a shade and a gap."""
    features = []
    for start in np.arange(0.0, 1.0, 0.2):
        features += [
            Feature("crossing", start + 0.10, length=0.1, angle=rng.uniform(0.4, 2.7)),
            Feature("parallel", start + 0.18, length=0.04, offset=rng.choice([-1, 1]) * rng.uniform(0.008, 0.015)),
            Feature("scratch", start + 0.05, offset=rng.uniform(-0.01, 0.01), angle=rng.uniform(-1, 1), width=0.001,
                    gray=float(rng.choice([60.0, 240.0]))),
            Feature("glare", start + 0.13, offset=rng.uniform(-0.008, 0.008), length=0.03),
            Feature("shade", start + 0.22, length=0.06),
            Feature("gap", start + 0.15, length=0.02),
        ]  # fmt: skip
    return tuple(f for f in features if f.at < 0.98)


def _shadows(rng: np.random.Generator) -> tuple[Feature, ...]:
    """Broad dark strokes with the line's own soft edge, across the line and along it, every 0.2 m."""
    return tuple(Feature("scratch", start, length=0.3, width=rng.uniform(0.01, 0.05), gray=rng.uniform(90.0, 150.0),
                         angle=rng.uniform(0.0, np.pi), offset=rng.uniform(-0.02, 0.02))
                 for start in np.arange(0.1, 1.0, 0.2))


def _worn(line: DrawnLine, rng: np.random.Generator) -> DrawnLine:
    """Width ±20 %, ink that has lost up to half of its contrast."""
    wide, pale = (np.sin(2.0 * np.pi * line.s / 0.15 + phase) for phase in rng.uniform(0.0, 2.0 * np.pi, 2))
    return replace(line, widths=line.width * (1.0 + 0.2 * wide),
                   grays=line.gray + 0.25 * (1.0 + pale) * (line.background - line.gray))


def _with_features(*kinds: str) -> Drawn:
    return lambda rng: _sine(tuple(feature for feature in _clutter(rng) if feature.kind in kinds))


def _on(kind: str, drawn: Drawn) -> Drawn:
    """The same on another surface."""
    return lambda rng: replace(drawn(rng), grain=kind, grain_seed=int(rng.integers(2**31)))


@dataclass(frozen=True)
class Case:
    """One disturbance: what is drawn, how the camera looks, and what is believed of it.

    Attributes:
        name: in the table.
        drawn: draws the line.
        settings, camera: of the simulated camera.
        believed: by the detector; the camera itself if None.
        speed: of the tool [m/s].
        late: by which the time stamp is wrong [s].
    """

    name: str
    drawn: Drawn = _clean
    settings: CameraSettings = QUIET
    camera: CameraModel = field(default_factory=CameraModel.default)
    believed: CameraModel | None = None
    speed: float = 0.0
    late: float = 0.0


C320, C640 = CameraModel.default(), CameraModel.default(640, 480)
PLAIN = replace(C320, distortion=np.zeros(5))
MOVING = Case("**2 ms exposure at 0.7 m/s, noise σ 3** (the default)", settings=USUAL, speed=0.7)
CASES = (
    Case("none"), Case("none, 640×480 (limited by the texel)", camera=C640),
    *(Case(f"gray noise σ {n}", settings=replace(QUIET, noise=float(n))) for n in (2, 5, 10)), MOVING,
    Case("crossings, parallel lines, scratches, glare, shade and gaps everywhere, noise σ 3",
         lambda _: _sine(_clutter(np.random.default_rng(5))), USUAL),
    *(Case(f"time stamp wrong by {late:g} ms at 0.7 m/s", speed=0.7, late=1e-3 * late) for late in (0.1, 1.0)),
    Case("lens distortion k1 = −0.2 ignored", believed=PLAIN),
    *(Case(name, believed=C320.perturbed(**change)) for name, change in (
        ("camera turned by 0.1° about the path (roll)", {"roll": radians(0.1)}),
        ("… about the lateral axis (pitch)", {"pitch": radians(0.1)}), ("… the vertical (yaw)", {"yaw": radians(0.1)}),
        ("camera 1 mm too high", {"height": 0.001}), ("focal length wrong by 0.1 %", {"focal": 0.001}),
        ("principal point off by 0.5 px", {"principal_u": 0.5}))),
)  # fmt: skip
SINGLE = (*(replace(MOVING, name=name, drawn=drawn) for name, drawn in (
    ("none", _clean), ("width ±20 %, ink faded by up to a half", lambda rng: _worn(_sine(), rng)),
    *((name, _with_features(name.removesuffix("s"))) for name in ("gaps", "glare", "shade")),
    ("edges of shadow", lambda rng: _sine(_shadows(rng))),
    ("crossing and parallel lines", _with_features("crossing", "parallel")), ("scratches", _with_features("scratch")),
    ("brushed metal", _on("metal", _clean)), ("wood", _on("wood", _clean)), ("paper", _on("paper", _clean)),
)), *(replace(MOVING, name=f"a real camera's picture{name}", drawn=drawn, settings=REAL) for name, drawn in (
    ("", _clean), (", width, ink and paper as above", _on("paper", lambda rng: _worn(_sine(), rng))))),
          replace(MOVING, name="exposure 8 ms (5.6 mm of way)",
              settings=replace(USUAL, exposure=0.008, sub_exposures=9)))
TOGETHER = replace(MOVING, name="all of them, on wood",
                   drawn=_on("wood", lambda rng: _worn(_sine((*_clutter(rng), *_shadows(rng))), rng)))


def _over(line: DrawnLine, s: float, aside: float, turn: float) -> pin.SE3:
    """The tool at arc length ``s``, looking along the line."""
    # The polyline's own tangent jumps from segment to segment; a tool's does not.
    (before, after), _ = line.at(np.array([s - 0.005, s + 0.005]))
    tangent = (after - before) / np.linalg.norm(after - before)
    rotation = np.column_stack([tangent, np.cross(-UP, tangent), -UP])
    on_line = pin.SE3(rotation, line.at(np.array([s]))[0][0])
    return on_line * pin.SE3(pin.rpy.rpyToMatrix(0, 0, turn), np.array([0.0, aside, 0.0]))


def _fields(case: Case, count: int, seed: int = 1) -> Iterator[tuple[dict[str, Array | None], float, float]]:
    """Errors of the points that each detector uses [m], None where it refuses; time of rendering and detecting [s].

    The time of detecting is that of the first detector, with the prediction of the windows.
    """
    rng = np.random.default_rng(seed)
    believed, detectors = case.believed or case.camera, {name: DETECTORS.get(name)() for name in DETECTORS.names()}
    settings, rate = DetectionSettings(), case.settings.rate
    for first in range(0, count, REDRAWN):
        line = case.drawn(rng)
        with RenderedCamera(case.camera, line, case.settings, rng) as camera:
            for i in range(min(REDRAWN, count - first)):
                s, aside, turn = rng.uniform(0.02, line.length - 0.15), rng.uniform(-3e-3, 3e-3), rng.uniform(-2, 2)
                t = case.settings.phase + i / rate

                def pose_at(at: float, s: float = s, t: float = t, aside: float = aside, turn: float = turn,
                            line: DrawnLine = line) -> pin.SE3:
                    return _over(line, s + case.speed * (at - t), aside, radians(turn))

                points, tangents = line.at(s + AHEAD)
                off, reported = rng.uniform(-1e-3, 1e-3) * np.cross(UP, tangents), pose_at(t + case.late)
                prediction = PredictedLine.from_base(points + off, tangents, UP, reported, 0.001)
                begin = time.thread_time()
                windows = search_windows(believed, prediction)
                middle = time.thread_time()
                picture = camera.windows(t, pose_at, windows)
                rendered = time.thread_time()
                errors: dict[str, Array | None] = {}
                detected = 0.0
                for name, detector in detectors.items():
                    sensed = detector.detect(picture, believed, prediction, settings)
                    detected = detected or time.thread_time() - rendered + middle - begin
                    on_line = sensed.points_tcp[sensed.used] @ reported.rotation.T + reported.translation
                    errors[name] = line.distance(on_line) if sensed.seen else None
                yield errors, rendered - middle, detected


def camera(fields: int = 200) -> None:
    """Error of line points under single disturbances, and the time that a field takes."""
    head("disturbance", "mean", "95 %", "max")
    for case in CASES:
        hits = [errors["edge_pairs"] for errors, *_ in list(_fields(case, fields + WARMING))[WARMING:]]
        e = 1e6 * np.concatenate([error for error in hits if error is not None])
        row(case.name, f"{e.mean():.0f}", f"{np.percentile(e, 95):.0f}", f"{e.max():.0f}")
        if case.drawn is not _clean:
            text = (f"\nOf the crossings and scratches {len(e) / fields:.1f} of 5 points are used per field, "
                    f"{100 * np.mean([error is not None for error in hits]):.1f} % of the fields are seen, the largest "
                    f"error of a point is {1e-3 * e.max():.2f} mm.\n")
    print(text)
    head("", "ms")
    default = CameraSettings()
    for name, settings, model in (
            ("picture of five windows: 2 ms exposure in 3 pictures, 2×2 samples a pixel", default, C320),
            ("the same, one picture", replace(default, sub_exposures=1), C320),
            ("the same, 4×4 samples", replace(default, supersampling=4), C320),
            ("the same, at 640×480", default, C640)):
        times = [timed[1:] for timed in list(_fields(Case(name, _clean, settings, model, speed=0.7), fields + WARMING))]
        rendering, detecting = 1e3 * np.median(times[WARMING:], axis=0)
        row(name, f"{rendering:.2f}")
        if settings is default and model is C320:
            row("windows predicted and line detected, five points", f"{detecting:.2f}")
    d = 1e-5 * np.arange(5.0)
    row("polynomial with covariance", f"{_time(lambda: fit_line_polynomial(AHEAD, d, d + 1e-5), 200):.2f}")
    line = _sine()
    with RenderedCamera(C320, line, QUIET, np.random.default_rng(0)) as eye:
        row("whole image for a report", f"{_time(lambda: eye.frame(_over(line, 0.2, 0.0, 0.0)), 5):.1f}")


def _time(job: Callable[[], object], repeats: int) -> float:
    return float(np.median([1e3 * used(job, time.thread_time) for _ in range(repeats)]))


def _aside(believed: CameraModel | HandEye, true: CameraModel) -> float:
    """Mean lateral error of points 20 to 110 mm ahead and up to 20 mm aside, of a believed camera [mm]."""
    return 1e3 * float(np.abs(measuring_error(true, believed, aside=0.02)).mean())


def calibration(seeds: int = 10, scenes: int = 3) -> None:
    """Lateral error of a camera mounted by hand, before and after calibration from the line: alone, and in scenes.

    Alone with --seeds seeds, poses exact and wrong; in scenes, all world effects on, with the seeds 1 to --scenes.
    """
    head("poses from the robot", "before, mean", "after, mean", "after, worst seed")
    for name, spread in (("exact", 0.0), ("wrong by 0.1 mm and 0.1 mrad (σ) at each pose", 1e-4)):
        before, after = np.array([_calibrated(seed, spread) for seed in range(seeds)]).T
        row(name, f"{before.mean():.2f} mm", f"{after.mean():.3f} mm", f"{after.max():.3f} mm")
    print()
    head("scene", "before", "after, deflection from the model", "after, deflection ignored")
    for name in ("line", "gap", "corner"):
        errors = np.array([[_calibrated_in(name, seed, deflected) for deflected in (True, False)]
                           for seed in range(1, scenes + 1)]).mean(axis=0)
        row(f"`{name}`", f"{errors[0, 0]:.1f} mm", *(f"{error:.3f} mm" for error in errors[:, 1]))


def _calibrated(seed: int, spread: float) -> tuple[float, float]:
    """Lateral error before and after [mm]; the told poses are off by ``spread`` [m and rad] (σ)."""
    error = CalibrationError(roll=radians(0.3), pitch=radians(0.3), yaw=radians(0.3), height=0.001, lateral=0.0005,
                             focal=0.003, principal_point=1.0, distortion=0.01)
    line, rng, believed = _sine(amplitude=0.03), np.random.default_rng(seed), C320
    true = believed.perturbed(**error.signed(rng))
    observations = []
    with RenderedCamera(true, line, CameraSettings(), rng) as eye:
        centre, tangent = (a[0] for a in line.at(np.array([0.5 * line.length])))
        for i, pose in enumerate(calibration_poses(centre, tangent, UP, 0.065)):
            s = line.nearest(pose.act(np.array([[0.065], [0.0], [0.0]])).T).s
            points, tangents = line.at(s + np.linspace(-0.07, 0.07, 9))
            prediction = PredictedLine.from_base(points + np.array([0.004, 0.006, 0.0]), tangents, UP, pose, 0.006)
            sensed = detect_line(eye.windows(0.005 + 0.02 * i, lambda t, pose=pose: pose,  # type: ignore[misc]
                                             search_windows(believed, prediction)), believed, prediction)
            reported = pose * pin.SE3(pin.exp3(spread * rng.standard_normal(3)), spread * rng.standard_normal(3))
            if sensed.seen:
                observations.append(Observation(reported, sensed.pixels[sensed.used], sensed.sigma[sensed.used]))
    result = calibrate(believed, observations, line.points + np.array([0.004, 0.006, 0.0]), UP)
    return _aside(believed, true), _aside(result, true)


def _calibrated_in(scene: str, seed: int, deflected: bool) -> tuple[float, float]:
    """The same by the simulated arm of a scene on the bench, gears' deflection from the model or ignored."""
    cell = set_up(scene_of(LineScene, scene).changed(seed=seed, world="bench"))
    known = cell.known
    bending = GearDeflection(model_for(known.scene, known.robot), cell.world.t_ipo) if deflected else None
    with (SimulatedArm(known.robot, cell.world, cell.noise, known.follower.q_start) as arm,
          RenderedCamera(cell.true_camera, cell.line, CameraSettings(), cell.camera_noise) as eye):
        result = calibrate_by_moving(known, arm, eye, bending, 0.5 * known.reference.length, SeenBefore())
    return _aside(known.camera, cell.true_camera), _aside(result, cell.true_camera)


def detectors(fields: int = 300, many: int = 10_000, seeds: str = "1") -> None:
    """Both line detectors on the same pictures: error, refusals, and points that are wrong but accepted.

    Each disturbance alone on --fields fields with seed 1, then, for each of --seeds, all at once on --many fields of
    lines drawn anew every 250 fields.
    """
    head("disturbance", "detector", "mean µm", "95 % µm", "max µm", "refused %", "points > 0.2 mm, %", "points > 1 mm")
    single = [(case, fields, 1) for case in SINGLE] if fields else []
    for case, count, seed in [*single, *((TOGETHER, many, seed) for seed in whole_numbers(seeds, "--seeds") if many)]:
        by_field = [errors for errors, *_ in _fields(case, count, seed)]
        which = f"{case.name}, {count} fields" + (f", seed {seed}" if case is TOGETHER else "")
        for name in by_field[0]:
            every = [errors[name] for errors in by_field]
            e = 1e6 * np.concatenate([np.empty(0), *(error for error in every if error is not None)])
            e = e if len(e) else np.array([np.nan])
            row(which, f"`{name}`", f"{e.mean():.0f}", f"{np.percentile(e, 95):.0f}", f"{e.max():.0f}",
                f"{100 * sum(error is None for error in every) / count:.1f}", f"{100 * np.mean(e > 200):.2f}",
                int(np.sum(e > 1000)))
