"""Estimates a camera's pose, on the tool or in the cell, from pictures of a checkerboard or AprilTags.

Eye in hand: the camera is on the tool, the target stands in the cell. Eye to hand: the camera stands in the cell, the
target is on the tool. Both are one equation. With A_i the known pose of the *mover* (the tool in the base frame for the
one, the base in the tool frame for the other), X the camera in the frame that it is fixed to, Y the target in the frame
that it is fixed to, a point p of the target is seen by camera i at

    u_i = π(X⁻¹ A_i⁻¹ Y p)

With T_i the target as picture i alone shows it, two pictures give A_i⁻¹ A_j X = X T_i T_j⁻¹, whose turns are one vector
in two frames: X starts from the rotation that aligns all of these vectors and the shift that then fits best (Park and
Martin), Y from the median of A_i X T_i. Both are refined together, by Gauss-Newton over all pixels. Pixels are not the
only thing that is uncertain: an arm does not stand where its motors say. A pose error δ_i of A_i, of unknown size,
moves all points of a picture together, so the residuals of one picture have the covariance

    Σ_i = σ_p² I + J_i diag(σ_φ² I_3, σ_t² I_3) J_iᵀ,   J_i = ∂u_i/∂δ_i

σ_p, σ_φ and σ_t are found with the rest: the three variances maximise the likelihood of the residuals (restricted
maximum likelihood), so the covariance of X and Y says what arm and camera really allow and not what noise of pixels
alone would.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import special
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from sensing import SensingError
from sensing.camera.camera_model import CameraModel

MOUNTED = ("tool", "cell")
"""What a camera is fixed to: the tool (eye in hand) or the cell (eye to hand)."""
LEAST_POSES = 4
"""Poses that a calibration needs at least: two turns about axes that differ determine it, one more is a check, and one
may show no target."""
LEAST_TURN = np.radians(10.0)
"""Turns about a second axis that poses have at least [rad]: without them the shift along the first shows nowhere."""
_MOVE = 1e-6
"""Moves over which slopes are taken [m, rad]."""
_STEPS = 20
_STILL = 1e-9
_FIRST = np.array([0.25, 1e-8, 1e-8])
"""Variances that the search begins with: half a pixel, 0.1 mm, 0.1 mrad [px², m², rad²]."""
_OUTLIER = 1e-4
"""Probability of a picture's residuals, were it right, below which it is left out."""


@dataclass(frozen=True)
class TargetView:
    """A target in one picture, and the tool pose that the robot measured.

    Attributes:
        pose: of the tool in the base frame.
        points: of the target, in the target's frame ``(m, 3)`` [m]; at least four, not on one line.
        pixels: where the picture shows them ``(m, 2)`` [px].
    """

    pose: pin.SE3
    points: Array
    pixels: Array


@dataclass(frozen=True)
class CameraPose:
    """Result of a hand-eye calibration; rotations are rotation vectors in the frame that they are given in.

    Attributes:
        mounted: ``tool`` or ``cell``: which frame the camera is fixed to.
        camera: pose of the camera in that frame.
        target: pose of the target in the base frame (camera on the tool) or in the tool frame (camera in the cell).
        covariance: of the camera's pose ``(6, 6)``: translation [m], then rotation [rad], in the camera's own frame.
        target_covariance: of the target's pose in its own frame, in the same order ``(6, 6)``.
        sigma_pixel: estimated standard deviation of a pixel [px].
        sigma_pose: estimated standard deviations of the arm's poses [m, rad] ``(2,)``.
        residual: root mean square of the pixels' residuals [px].
        used: pictures that took part ``(n,)``; false where no such error explains one.
    """

    mounted: str
    camera: pin.SE3
    target: pin.SE3
    covariance: Array
    target_covariance: Array
    sigma_pixel: float
    sigma_pose: tuple[float, float]
    residual: float
    used: NDArray[np.bool_]


def locate_camera(views: Sequence[TargetView], camera: CameraModel, mounted: str = "tool") -> CameraPose:
    """Estimates the camera's pose, with covariance, from pictures of one target that stayed where it is fixed.

    Args:
        views: at least ``LEAST_POSES``, with turns about at least two axes.
        camera: its intrinsics; its mount is not read.
        mounted: of ``MOUNTED``.

    Raises:
        InputError: no such ``mounted``.
        SensingError: too few pictures, or poses that do not turn about two axes.
    """
    if mounted not in MOUNTED:
        raise InputError(f"expected one of {', '.join(MOUNTED)}", field="mounted", value=mounted)
    if len(views) < LEAST_POSES:
        raise SensingError(f"{len(views)} pictures show the target; at least {LEAST_POSES} are needed")
    movers = [view.pose if mounted == "tool" else view.pose.inverse() for view in views]
    _check_turns(movers)
    seen = [_target_in_camera(view, camera) for view in views]
    X, Y = _start(movers, seen)
    used = np.ones(len(views), dtype=bool)
    problem, fit = _solved(views, movers, camera, used, X, Y)
    while used.sum() > LEAST_POSES:
        worst = int(np.flatnonzero(used)[np.argmax(fit.distances)])
        # A picture is judged by the others' estimate alone, as a wrong picture enlarges the variances that would excuse
        # it.
        used[worst] = False
        others = _solved(views, movers, camera, used, fit.camera, fit.target)
        alone = _Problem([views[worst]], [movers[worst]], camera)
        (row,) = alone.compressed(others[1].camera, others[1].target)
        free = 6 * int(used.sum()) - 12
        most = 6.0 * special.fdtri(6, max(free, 1), 1.0 - _OUTLIER / len(views))
        if row.distance(np.zeros(12), others[1].variances) <= most:
            used[worst] = True
            break
        problem, fit = others
    X, Y, covariance = fit.camera, fit.target, fit.covariance
    residual = float(np.sqrt(np.mean(np.concatenate(problem.residuals(X, Y)) ** 2)))
    sigma = np.sqrt(fit.variances)
    return CameraPose(mounted, X, Y, covariance[:6, :6], covariance[6:, 6:], float(sigma[0]),
                      (float(sigma[1]), float(sigma[2])), residual, used)


def _check_turns(movers: Sequence[pin.SE3]) -> None:
    """Refuses poses that turn about one axis only."""
    turns = np.array([pin.log3(movers[0].rotation.T @ other.rotation) for other in movers[1:]])
    second = np.linalg.svd(turns, compute_uv=False)[1]
    if second < LEAST_TURN:
        raise SensingError(f"the poses turn about one axis and about no other by more than {np.degrees(second):.1f}°: "
                           "turn the tool about two axes by 20° or more")


def _target_in_camera(view: TargetView, camera: CameraModel) -> pin.SE3:
    """Pose of the target in the camera's frame, from one picture."""
    solved, turn, shift = cv2.solvePnP(np.ascontiguousarray(view.points, dtype=float),
                                       np.ascontiguousarray(view.pixels, dtype=float), camera.K, camera.distortion,
                                       flags=cv2.SOLVEPNP_SQPNP)
    if not solved:
        raise SensingError("the points of a picture determine no pose of the target; leave that picture out")
    turn, shift = cv2.solvePnPRefineLM(np.ascontiguousarray(view.points, dtype=float),
                                       np.ascontiguousarray(view.pixels, dtype=float), camera.K, camera.distortion,
                                       turn, shift)
    return pin.SE3(pin.exp3(turn.ravel()), shift.ravel())


def _start(movers: Sequence[pin.SE3], seen: Sequence[pin.SE3]) -> tuple[pin.SE3, pin.SE3]:
    """Camera and target from the turns and shifts between all pairs of poses."""
    pairs = [(movers[i].actInv(movers[j]), seen[i] * seen[j].inverse()) for i in range(len(seen)) for j in range(i)]
    turn = Rotation.align_vectors([pin.log3(a.rotation) for a, _ in pairs], [pin.log3(b.rotation) for _, b in pairs])[0]
    R = np.asarray(turn.as_matrix())
    left = np.concatenate([a.rotation - np.eye(3) for a, _ in pairs])
    right = np.concatenate([R @ b.translation - a.translation for a, b in pairs])
    X = pin.SE3(R, np.linalg.lstsq(left, right, rcond=None)[0])
    targets = [mover * X * target for mover, target in zip(movers, seen, strict=True)]
    turns = [pin.log3(targets[0].rotation.T @ target.rotation) for target in targets]
    rotation = targets[0].rotation @ pin.exp3(np.median(turns, axis=0))
    return X, pin.SE3(rotation, np.median([target.translation for target in targets], axis=0))


@dataclass(frozen=True)
class _Fit:
    """Camera, target, variances [px², m², rad²] ``(3,)``, covariance ``(12, 12)``, squared distance of each picture."""

    camera: pin.SE3
    target: pin.SE3
    variances: Array
    covariance: Array
    distances: Array


def _solved(views: Sequence[TargetView], movers: Sequence[pin.SE3], camera: CameraModel, used: NDArray[np.bool_],
            X: pin.SE3, Y: pin.SE3) -> tuple[_Problem, _Fit]:
    chosen = np.flatnonzero(used).tolist()
    problem = _Problem([views[i] for i in chosen], [movers[i] for i in chosen], camera)
    return problem, problem.solve(X, Y)


class _Problem:
    """Residuals of all pixels as a function of camera and target, and how an error of the arm's pose moves them."""

    def __init__(self, views: Sequence[TargetView], movers: Sequence[pin.SE3], camera: CameraModel) -> None:
        self.views, self.movers, self.camera = views, movers, camera

    def residuals(self, X: pin.SE3, Y: pin.SE3) -> list[Array]:
        """Seen less expected, of each picture ``(2 m,)`` [px]."""
        return [self._residual(i, X, Y, pin.SE3.Identity()) for i in range(len(self.views))]

    def _residual(self, i: int, X: pin.SE3, Y: pin.SE3, error: pin.SE3) -> Array:
        view = self.views[i]
        T = (self.movers[i] * error * X).inverse() * Y
        pixels = self.camera.project(np.asarray(view.points) @ T.rotation.T + T.translation)
        return np.asarray((np.asarray(view.pixels) - pixels).ravel())

    def _linearised(self, X: pin.SE3, Y: pin.SE3) -> list[tuple[Array, Array, Array]]:
        """Residual of each picture, its derivative, and its derivative by an error of the arm's pose.

        ``(2 m,)``; by camera and target ``(2 m, 12)``; ``(2 m, 6)``: translation [m], then rotation [rad] of each.
        """
        identity = pin.SE3.Identity()
        moves = [pin.exp6(pin.Motion(_MOVE * unit)) for unit in np.eye(6)]
        rows = []
        for i in range(len(self.views)):
            r = self._residual(i, X, Y, identity)
            of_camera = [(self._residual(i, X * move, Y, identity) - r) / _MOVE for move in moves]
            of_target = [(self._residual(i, X, Y * move, identity) - r) / _MOVE for move in moves]
            of_pose = [(self._residual(i, X, Y, move) - r) / _MOVE for move in moves]
            rows.append((r, np.array(of_camera + of_target).T, np.array(of_pose).T))
        return rows

    def compressed(self, X: pin.SE3, Y: pin.SE3) -> list[_Compressed]:
        """Residuals of each picture and their derivatives, reduced to what one step of ``solve`` adds up."""
        return [_Compressed.of(*row) for row in self._linearised(X, Y)]

    def solve(self, X: pin.SE3, Y: pin.SE3) -> _Fit:
        """Gauss-Newton over camera and target, the variances found anew at each step, until neither moves."""
        variances = _FIRST
        for _ in range(_STEPS):
            rows = self.compressed(X, Y)
            variances = _variances(rows, variances)
            N, g = np.zeros((12, 12)), np.zeros(12)
            for row in rows:
                A, b, _value = row.weighted(variances)
                N, g = N + A, g + b
            step = -np.linalg.solve(N, g)
            X, Y = X * pin.exp6(pin.Motion(step[:6])), Y * pin.exp6(pin.Motion(step[6:]))
            if float(step @ N @ step) < _STILL * 12:
                break
        distances = np.array([row.distance(np.asarray(step, dtype=float), variances) for row in rows])
        return _Fit(X, Y, variances, np.asarray(np.linalg.inv(N), dtype=float), distances)


@dataclass(frozen=True)
class _Compressed:
    """A picture's residuals in the basis of its pose error: six numbers that it moves, and the rest, which it does not.

    Attributes:
        r, J: residual ``(6,)`` and its slope ``(6, 12)`` in that basis.
        B: how the pose error moves it ``(6, 6)``.
        J_rest, r_rest: of what is outside of the basis JᵀJ ``(12, 12)`` and Jᵀr ``(12,)``.
        rest, count: sum of squares of the residual outside, and its degrees of freedom.
    """

    r: Array
    J: Array
    B: Array
    J_rest: Array
    r_rest: Array
    rest: float
    count: int

    @classmethod
    def of(cls, r: Array, J: Array, B: Array) -> _Compressed:
        Q, R = np.linalg.qr(B)
        r_in, J_in = Q.T @ r, Q.T @ J
        r_out, J_out = r - Q @ r_in, J - Q @ J_in
        return cls(r_in, J_in, R, J_out.T @ J_out, J_out.T @ r_out, float(r_out @ r_out), len(r) - len(r_in))

    def _inside(self, variances: Array) -> Array:
        pixel, shift, turn = variances
        return pixel * np.eye(len(self.r)) + self.B @ np.diag(np.repeat([shift, turn], 3)) @ self.B.T

    def weighted(self, variances: Array) -> tuple[Array, Array, float]:
        """Normal matrix, gradient, and logarithm of the likelihood, up to a constant and with the sign turned."""
        S = self._inside(variances)
        W = np.linalg.inv(S)
        N = self.J.T @ W @ self.J + self.J_rest / variances[0]
        g = self.J.T @ W @ self.r + self.r_rest / variances[0]
        value = 0.5 * (float(self.r @ W @ self.r) + self.rest / variances[0] + np.linalg.slogdet(S)[1]
                       + self.count * np.log(variances[0]))
        return N, g, float(value)

    def distance(self, step: Array, variances: Array) -> float:
        """Squared Mahalanobis distance of what a pose error would move, six numbers, after a step ``(12,)``."""
        r = self.r + self.J @ step
        return float(r @ np.linalg.solve(self._inside(variances), r))


def _variances(rows: Sequence[_Compressed], start: Array) -> Array:
    """The variances of pixel, shift and turn that make the residuals likeliest (restricted) ``(3,)``."""

    def loss(logs: Array) -> float:
        N, g, total = np.zeros((12, 12)), np.zeros(12), 0.0
        for row in rows:
            A, b, value = row.weighted(np.exp(logs))
            N, g, total = N + A, g + b, total + value
        # The quadratic's minimum is lower by half gᵀ N⁻¹ g; the determinant accounts for the twelve estimated
        # parameters.
        return total - 0.5 * float(g @ np.linalg.solve(N, g)) + 0.5 * float(np.linalg.slogdet(N)[1])

    bounds = [(np.log(1e-6), np.log(1e2)), (np.log(1e-14), np.log(1e-2)), (np.log(1e-14), np.log(1e-1))]
    fit = minimize(loss, np.log(start), method="L-BFGS-B", bounds=bounds)
    return np.asarray(np.exp(fit.x))


def checkerboard(picture: NDArray[np.uint8], columns: int, rows: int, square: float) -> tuple[Array, Array] | None:
    """Inner corners of a checkerboard in a picture, in the board's frame ``(m, 3)`` [m] and as pixels, or None.

    Args:
        picture: gray or BGR.
        columns: inner corners along the board.
        rows: inner corners across it; columns and rows should differ in parity, else a turned board looks the same.
        square: side of a square [m].
    """
    gray = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCornersSB(gray, (columns, rows),
                                                 flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY)
    if not found:
        return None
    v, u = np.divmod(np.arange(columns * rows), columns)
    return np.column_stack([u * square, v * square, np.zeros(len(u))]), np.asarray(corners, float).reshape(-1, 2)


def april_tags(picture: NDArray[np.uint8], places: dict[int, Array], family: str = "36h11"
               ) -> tuple[Array, Array] | None:
    """Corners of AprilTags in a picture, in the target's frame ``(m, 3)`` [m] and in pixels ``(m, 2)``, or None.

    Args:
        picture: gray or BGR.
        places: of each tag by its number its corners in the target's frame ``(4, 3)`` [m], from the upper left one
            clockwise as the upright tag is seen.
        family: ``16h5``, ``25h9``, ``36h10`` or ``36h11``.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family}"))
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(picture)
    known = [(places[int(number)], quad.reshape(4, 2)) for number, quad in zip(np.ravel(numbers) if numbers is not None
                                                                                else [], corners, strict=False)
             if int(number) in places]
    if not known:
        return None
    return np.concatenate([place for place, _ in known]), np.concatenate([quad for _, quad in known]).astype(float)
