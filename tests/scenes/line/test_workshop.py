"""What a workshop does to the line: a surface that is not where it should be, and nobody is told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.feedforward.arm_of_its_type import arm_of_its_type
from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.line.cell import STRIPS, bent_surface, prepared, set_up
from scenes.line.kind import run
from scenes.models import model_for, own_model
from scenes.scene_files.drawn_line import geometry
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import OWN, chosen
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_detection import PredictedLine, detect_line, search_windows
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import CameraSettings
from sim.camera.surface import DrawnLine, paint
from tests.scenes.line.test_line import CALIBRATED, followed, short
from tests.sensing.camera.synthetic import tool_over


def test_a_displaced_surface_moves_the_line_and_not_the_reference() -> None:
    nominal = set_up(short())
    moved = set_up(short(displacement={"height_mm": 4.0, "tilt_deg": 2.0}))
    up = nominal.geometry.plane.rotation[:, 2]
    np.testing.assert_array_equal(moved.geometry.reference, nominal.geometry.reference)
    np.testing.assert_allclose(moved.known.reference.frames(0.3).up, nominal.known.reference.frames(0.3).up)
    middle = (moved.line.points.mean(axis=0) - nominal.line.points.mean(axis=0)) @ up
    assert 1.9e-3 < abs(middle) < 4.1e-3
    angle = np.degrees(np.arccos(moved.geometry.plane.rotation[:, 2] @ up))
    assert 1.4 < angle < 2.9
    # The line lies on the surface.
    plane = moved.geometry.plane
    np.testing.assert_allclose((moved.line.points - plane.translation) @ plane.rotation[:, 2], 0.0, atol=1e-12)


@pytest.mark.slow
def test_kinematic_errors_and_a_displaced_surface_hardly_matter() -> None:
    """What is sensed relative to the tool does not ask where arm and surface think they are ([L] 3.1)."""
    scene = load_scene("line").changed(calibration=CALIBRATED, displacement={"height_mm": 3.0},
                                       world={"base": "bench", "kinematic_error": 3e-4, "zero_error": 3.5e-4})
    followed(scene, 1.0e-4)


@pytest.mark.slow
def test_a_line_of_another_shape_than_its_reference_is_followed() -> None:
    """A straight reference before a sine of 40 mm, with calibration by moving ([L] 5: *positions or the shapes*)."""
    result = followed(load_scene("line").changed(reference={"shape": {"points": [[0.0, 0.0], [1.2, 0.0]]}}), 1.5e-4)
    assert result.hand_eye is not None
    assert np.max(np.abs(result.believed)) > 0.035


def test_a_line_too_far_from_its_reference_is_said_before_it_is_lost() -> None:
    bent = "0.12*(6*(x/0.5)**5-15*(x/0.5)**4+10*(x/0.5)**3)*(x<0.5)+0.12*(x>=0.5)"
    scene = load_scene("line").changed(line={"formula": bent, "length": 1.2},
                                       reference={"shape": {"points": [[0.0, 0.0], [1.2, 0.0]]}})
    with prepared(scene) as before:
        assert "mm beside its reference" in before.warning


@pytest.mark.slow
def test_the_height_of_a_tilted_surface_shows_while_following() -> None:
    """With the height taken from the reference this line is missed by 0.7 mm: ten millimetres at its ends ([L] 4.2)."""
    followed(load_scene("line").changed(world="bench", seed=2, calibration=CALIBRATED, displacement={"tilt_deg": 1.0}),
             1.2e-4)


def test_the_whole_workshop_is_followed_with_calibration_by_moving() -> None:
    result = followed(load_scene("line"), 1.0e-4)
    assert result.json()["world"] == "workshop"
    assert result.control_error.p95 < 3.5e-4


@pytest.mark.slow
def test_with_the_arm_in_the_picture_the_line_is_followed_and_a_run_repeats_bit_for_bit() -> None:
    scene = load_scene("line").changed(tool_mm=150.0)
    first, again = followed(scene, 1.0e-4), run(scene)
    assert first.recording.columns.keys() == again.recording.columns.keys()
    for name, values in first.recording.columns.items():
        np.testing.assert_array_equal(again.recording.columns[name], values, err_msg=name)


def test_the_workshop_holds_where_a_scene_says_nothing() -> None:
    workshop, bench = load_scene("line"), load_scene("line").changed(world="bench")
    assert workshop.world["kinematic_error"] == pytest.approx(3e-4)
    assert (workshop.displacement.tilt_deg, workshop.wear.gaps, workshop.camera.loss) == (1.0, 2, 0.05)
    assert bench.arm_world == {}
    assert (bench.displacement.tilt_deg, bench.wear.gaps, bench.camera.loss) == (0.0, 0, 0.0)
    # What is given stays, and nothing is lost on the way there and back.
    own = workshop.changed(displacement={"tilt_deg": 0.2}, world={"individual": 4})
    assert own.displacement.tilt_deg == 0.2
    assert own.displacement.height_mm == workshop.displacement.height_mm
    assert own.changed(world="bench").arm_world == {"individual": 4}
    assert own.changed(world="bench").changed(world="workshop").model_dump() == own.model_dump()
    assert type(own).model_validate_json(own.model_dump_json()).model_dump() == own.model_dump()
    with pytest.raises(InputError, match="workshop"):
        workshop.changed(world="garage")
    with pytest.raises(InputError, match="bench"):
        load_scene("iso9283_1").changed(world="workshop")


def test_a_cell_is_a_workshop_with_pictures_and_an_arm_as_cells_have_them() -> None:
    workshop, cell = load_scene("line"), load_scene("line").changed(world="cell")
    assert (cell.displacement, cell.light) == (workshop.displacement, workshop.light)
    real = load_scene("real_camera")
    assert (cell.camera, cell.wear) == (real.camera, real.wear)
    assert cell.arm_world == {"cell": True, **workshop.arm_world}
    assert cell.changed(world="workshop").model_dump() == workshop.model_dump()
    assert load_scene("force_wave").changed(world="cell").arm_world["cell"] is True
    # On a path the arm is calibrated; a clamped one has no world of that kind.
    assert load_scene("iso9283_1").changed(world="cell").arm_world == {"cell": True}
    with pytest.raises(InputError, match="bench"):
        load_scene("clamped_kr500_1").changed(world="cell")


def test_wear_is_drawn_by_the_seed_and_changes_what_is_painted() -> None:
    scene = short(wear={"width_percent": 20.0, "fade_percent": 30.0, "gaps": 2})
    line, again, other = (set_up(variant).line for variant in (scene, scene, scene.changed(seed=2)))
    assert line.widths is not None
    assert line.grays is not None
    np.testing.assert_array_equal(line.widths, again.widths)
    assert not np.array_equal(line.widths, other.widths)
    assert np.ptp(line.widths) > 0.15 * line.width
    assert line.grays.min() >= line.gray
    assert [feature.kind for feature in line.features] == ["gap", "gap"]
    # Dark texels across the line are as many as its width there says.
    texture = paint(line)
    wide, narrow = np.argmax(line.widths[100:-100]) + 100, np.argmin(line.widths[100:-100]) + 100
    widths = []
    for i in (wide, narrow):
        column = int((line.plane_points[i, 0] - texture.x_min) / texture.resolution)
        cover = (line.background - texture.image[:, column]) / (line.background - line.grays[i])
        widths.append(float(cover.sum() * texture.resolution))
    np.testing.assert_allclose(widths, line.widths[[wide, narrow]], rtol=0.05)


def test_a_camera_that_somebody_knocks_on_the_way_is_found_out() -> None:
    """Without the hypothesis of a moved sensor the map turns with the camera, and the line is missed by millimetres."""
    scene = load_scene("line").changed(world="bench", calibration=CALIBRATED, camera={"knock_deg": 0.5})
    assert followed(scene, 1.0e-4).control_error.max < 4.0e-4


def test_a_field_that_comes_twice_is_one_measurement() -> None:
    once, twice = (run(short(camera={"doubled": share}), method="ideal") for share in (0.0, 0.5))
    assert twice.fields_seen == once.fields_seen
    assert twice.control_error.mean == once.control_error.mean


@pytest.mark.slow
def test_the_tool_in_the_picture_is_not_taken_for_the_line() -> None:
    scene = load_scene("line").changed(seed=3)
    assert scene.camera.renderer == "bullet"
    with prepared(scene) as cell:
        assert cell.detection.line_width == pytest.approx(0.003, rel=0.25)
        assert cell.hand_eye is not None


@pytest.mark.parametrize(("change", "share"), [
    # [L] 2.2, 3.2: friction of 20 °C and a model of 35 °C; what calibration moved is what there is to learn from.
    pytest.param({"world": {"base": "bench", "start_temperature": 20.0}}, 0.92, id="cold arm"),
    # Its masses and ripple: by friction alone it is followed no better adapted than not.
    pytest.param({"world": {"base": "bench", "individual": 4}}, 0.6, id="arm of another model", marks=pytest.mark.slow),
    *(pytest.param({"world": "bench", "seed": seed}, 1.03, id=f"nothing to adapt, {seed}", marks=pytest.mark.slow)
      for seed in (1, 2)),
    # 0.6 in the workshop, where two factors alone, without friction's shape over speed, gave 0.87.
    pytest.param({}, 0.75, id="friction that falls before it rises, at reversals", marks=pytest.mark.slow),
])
@pytest.mark.slow
def test_adapting_while_the_camera_is_calibrated_leaves_a_share_of_the_error(change: dict[str, Any], share: float
                                                                            ) -> None:
    scene = load_scene("line").changed(**change)
    with prepared(scene) as shared:
        fixed, adapted = (run(scene, method=key, shared=shared).control_error.mean for key in ("ideal", "adapted"))
    assert adapted < share * fixed


@pytest.mark.parametrize("tool", [2.0, pytest.param(0.0, marks=pytest.mark.slow)])
def test_an_arm_whose_links_swing_behind_their_gears_is_no_other(tool: float) -> None:
    """Moved from pose to pose in tenths of a second; motors alone show another arm, as did a tool heavier than told."""
    scene = load_scene("line").changed(world={"base": "bench", "payload_mass": tool, "payload_com": (0.0, 0.0, -0.08)},
                                       model="shipped")
    cell = set_up(scene)
    model = model_for(scene, cell.known.robot)
    with prepared(scene) as shared:
        assert shared.recorded is not None
        assert arm_of_its_type(shared.recorded, model, cell.known.robot).effects is model.effects
        rigid = replace(model, gears=None)
        assert arm_of_its_type(shared.recorded, rigid, cell.known.robot).effects is not rigid.effects


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_who_adapts_a_cold_arm_is_within_1_3_of_who_knew(seed: int) -> None:
    """Seeds 2 and 3 of `python -m studies knew`, and not worse than without by more than 3 %: 1.3 and 1.5 times
    when torques of the ends of cycles were taken for friction."""
    line = chosen(load_scene("line"), individual=1)
    before = own_model(line, Robot.load(line.robot))
    cold = line.changed(seed=seed, world={"start_temperature": 20.0})
    knew = run(cold.changed(model=OWN), method="ideal").control_error.mean
    fixed, adapted = (run(cold.changed(model=before), method=key).control_error.mean for key in ("ideal", "adapted"))
    assert adapted < 1.3 * knew
    assert adapted < 1.03 * fixed


def test_a_grain_is_of_its_size_and_repeats_with_the_seed() -> None:
    even, wooden = (paint(set_up(short(wear={"grain": grain})).line).image.astype(float) for grain in ("none", "wood"))
    bare = even == 200.0
    assert bare.mean() > 0.9
    assert np.std(wooden[bare]) == pytest.approx(15.0, rel=0.1)
    np.testing.assert_array_equal(wooden, paint(set_up(short(wear={"grain": "wood"})).line).image)
    # Streaks along the line: neighbours along it are alike over centimetres, across it over millimetres.
    along, across = (np.mean(np.abs(np.roll(wooden, 40, axis)[bare] - wooden[bare])) for axis in (1, 0))
    assert along < 0.7 * across


def test_a_run_is_bit_identical_for_the_same_scene_seed_and_individual() -> None:
    """Arm, camera, light and wear draw from nothing else."""
    scene = load_scene("line").changed(line={"formula": None, "length": None, "points": [(0.4, 0.0), (0.7, 0.0)]},
                                       calibration=CALIBRATED, world={"individual": 2})
    first, again = run(scene), run(scene)
    for signal in ("q_c", "q", "tau"):
        np.testing.assert_array_equal(first.recording.joints(signal), again.recording.joints(signal))
    assert first.control_error.mean == again.control_error.mean


# A surface that is bent along the line: nothing at the line's ends, the bow in its middle, up or down by the seed.

def scene(**displacement: float) -> LineScene:
    return load_scene("line").changed(displacement=displacement)  # type: ignore[return-value]


def test_the_middle_is_out_of_the_plane_of_the_ends_by_the_bow() -> None:
    bent = scene(bow_mm=1.0)
    where = geometry(bent, np.random.default_rng(3))
    middles = set()
    for seed in range(8):
        surface = bent_surface(bent, where, np.random.default_rng(seed))
        assert surface is not None
        height = surface.height(where.drawn_xy[:, 0], where.drawn_xy[:, 1])
        assert np.abs(height).max() == pytest.approx(1e-3, rel=1e-4)
        assert np.abs(height[[0, -1]]).max() < 1e-4
        middles.add(round(1e3 * float(height[len(height) // 2])))
    assert middles == {-1, 1}


def test_a_flat_surface_has_no_relief_and_a_bent_one_needs_a_renderer() -> None:
    where = geometry(scene(), np.random.default_rng(3))
    assert bent_surface(scene(), where, np.random.default_rng(0)) is None
    with pytest.raises(InputError, match="renderer"):
        bent_surface(scene(bow_mm=1.0).changed(camera={"renderer": "sampled"}),  # type: ignore[arg-type]
                     where, np.random.default_rng(0))


def test_the_camera_sees_the_line_where_the_bent_surface_lifts_it() -> None:
    """Seen from aside, a place 2 mm higher looks nearer to the point below the camera by 2 mm of 250."""
    bent = scene(bow_mm=2.0)
    where = geometry(bent, np.random.default_rng(3))
    surface = next(candidate for candidate in (bent_surface(bent, where, np.random.default_rng(k)) for k in range(9))
                   if candidate is not None and candidate.waves[0].amplitude > 0)
    line, model = DrawnLine(where.drawn, where.plane), CameraModel.default()
    points, tangents = line.at(0.5 * line.length + np.linspace(-0.03, 0.03, 5))
    up = where.plane.rotation[:, 2]
    xy = where.plane.actInv(points[2])
    heading = where.plane.rotation.T @ tangents[2]
    yaw = float(np.arctan2(heading[1], heading[0]))
    aside, lift = 0.025, 0.002
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    foot = xy[:2] - 0.065 * ahead + aside * np.array([-ahead[1], ahead[0]])
    tool = tool_over(*foot, yaw, plane=where.plane)
    prediction = PredictedLine.from_base(points, tangents, up, tool, 0.001)
    settings = CameraSettings(exposure=0.0, noise=0.0, jitter=0.0, stamp_noise=0.0)
    with BulletCamera(model, line, settings, np.random.default_rng(0), relief=surface, strips=STRIPS) as camera:
        field = camera.windows(0.025, lambda t: tool, search_windows(model, prediction))
    detected = detect_line(field, model, prediction)
    assert detected.used.all()
    assert np.abs(detected.lateral[2]) == pytest.approx(aside * lift / (0.25 - lift), rel=0.15)
