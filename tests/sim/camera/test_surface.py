"""The drawn line: geometry, features, and what is painted of it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from sim.camera.surface import DrawnLine, Feature
from sim.camera.texture import Texture, paint

X = np.arange(0.0, 0.3, 0.0005)
XY = np.column_stack([X, 0.02 * np.sin(15 * X)])
PLANE = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.05, 0.7), np.array([0.8, 0.1, 0.4]))


def gray_at(texture: Texture, x: float, y: float) -> int:
    row, column = (texture.y_max - y) / texture.resolution, (x - texture.x_min) / texture.resolution
    return int(texture.image[int(row), int(column)])


def beside(line: DrawnLine, s: float, offset: float) -> tuple[float, float]:
    """A place in the plane, to the left of the line."""
    point, tangent = (a[0] for a in line.at(np.array([s])))
    point = point + offset * np.cross(line.plane.rotation[:, 2], tangent)
    x, y, _ = line.plane.actInv(point)
    return float(x), float(y)


def test_distance_in_space_and_in_the_plane() -> None:
    line = DrawnLine.from_plane_points(XY, PLANE)
    points, tangents = line.at(np.array([0.1, 0.2]))
    left = np.cross(PLANE.rotation[:, 2], tangents)
    queries = points + 0.004 * left + 0.003 * PLANE.rotation[:, 2]
    np.testing.assert_allclose(line.distance(queries), 0.005, atol=1e-6)
    np.testing.assert_allclose(line.nearest(queries).lateral, 0.004, atol=1e-6)
    np.testing.assert_allclose(line.nearest(queries).s, [0.1, 0.2], atol=1e-5)


def test_painted_line_has_its_width_and_a_soft_edge() -> None:
    line = DrawnLine.from_plane_points(np.array([[0.0, 0.0], [0.2, 0.0]]), pin.SE3.Identity(), width=0.003, edge=0.001)
    texture = paint(line, resolution=0.0001, margin=0.02)
    across = [gray_at(texture, 0.1, y) for y in (0.0, 0.0009, 0.00125, 0.00175, 0.0021, 0.01)]
    assert across[0] == across[1] == 40
    assert across[4] == across[5] == 200
    # A quarter and three quarters up the edge, to a texel's half.
    assert across[2] == pytest.approx(80, abs=16)
    assert across[3] == pytest.approx(160, abs=16)
    assert texture.size == pytest.approx((0.24, 0.04), abs=2e-4)


def test_painted_where_the_geometry_says() -> None:
    line = DrawnLine.from_plane_points(XY, PLANE)
    texture = paint(line, margin=0.02)
    for s in np.linspace(0.01, line.length - 0.01, 30):
        assert gray_at(texture, *beside(line, s, 0.0)) == 40
        assert gray_at(texture, *beside(line, s, 0.003)) == 200
        assert gray_at(texture, *beside(line, s, -0.003)) == 200


@pytest.mark.parametrize(("feature", "where", "gray"), [
    (Feature("gap", 0.15, length=0.02), (0.15, 0.0), 200),
    (Feature("gap", 0.15, length=0.02), (0.17, 0.0), 40),
    (Feature("crossing", 0.15, length=0.04), (0.15, 0.015), 40),
    (Feature("crossing", 0.15, length=0.04), (0.15, 0.025), 200),
    (Feature("parallel", 0.15, length=0.04, offset=0.01), (0.16, 0.01), 40),
    (Feature("parallel", 0.15, length=0.04, offset=0.01), (0.16, -0.01), 200),
    (Feature("scratch", 0.15, offset=0.008, width=0.002, angle=0.0), (0.15, 0.008), 235),
    (Feature("glare", 0.15, offset=0.01), (0.15, 0.01), 255),
    (Feature("glare", 0.15, offset=0.01), (0.15, -0.01), 200),
    (Feature("shade", 0.15, offset=0.01, gray=50.0), (0.15, 0.01), 100),
])  # fmt: skip
def test_features(feature: Feature, where: tuple[float, float], gray: int) -> None:
    line = DrawnLine.from_plane_points(XY, PLANE, features=(feature,))
    assert gray_at(paint(line, margin=0.05), *beside(line, *where)) == pytest.approx(gray, abs=2)


def test_a_patch_beyond_the_surface_is_harmless() -> None:
    line = DrawnLine.from_plane_points(XY, PLANE, features=(Feature("glare", 0.0, offset=5.0),))
    assert paint(line, margin=0.02).image.max() == 200


@pytest.mark.parametrize(("table", "field"), [
    ({"kind": "hole", "at": 0.1}, "kind"), ({"kind": "gap"}, "at"), ({"kind": "gap", "at": 0.1, "colour": 3}, "colour"),
    ({"kind": "gap", "at": 0.1, "length": 0.0}, "gap"),
])  # fmt: skip
def test_wrong_features_are_named(table: dict[str, object], field: str) -> None:
    with pytest.raises(InputError, match=field):
        Feature.from_table(table)


def test_wrong_lines_are_refused() -> None:
    with pytest.raises(InputError, match="must lie on its plane"):
        DrawnLine(np.array([[0.0, 0, 0], [1, 0, 0.1]]), pin.SE3.Identity())
    with pytest.raises(InputError, match="coincide"):
        DrawnLine.from_plane_points(np.zeros((3, 2)), pin.SE3.Identity())
    with pytest.raises(InputError, match="width"):
        DrawnLine.from_plane_points(XY, PLANE, width=-1.0)
    with pytest.raises(InputError, match="texels"):
        paint(DrawnLine.from_plane_points(XY, PLANE), resolution=1e-5)
    with pytest.raises(InputError, match="inf × inf texels"):
        paint(DrawnLine.from_plane_points(XY, PLANE), resolution=1e-320)
    with pytest.raises(InputError, match="resolution"):
        paint(DrawnLine.from_plane_points(XY, PLANE), resolution=0.0)
