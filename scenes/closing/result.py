"""The result of ``close-loop``: errors before and after, every trial, what is kept and why the rest is not."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.arrays import Array, eased, interpolated
from ideal_robot.diagnosis import Diagnosis
from ideal_robot.effects import FittedEffect
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.results import plain
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.closing.loop import MODEL, Closed, Place, Step, places_of, said
from scenes.diagnosis.page import add_diagnosis, summary
from scenes.metrics import path_errors
from scenes.outputs import whole_folder
from scenes.report.page import Report
from scenes.result import ShownTable
from scenes.scene_files.scene import Scene

SHARES = {"before": 0.05, "rounds": 0.6, "oracle": 0.15, "report": 0.2}
"""Measured shares of the time that ``close-loop`` takes."""
_COLOURS = {"before": "#b0413e", "after": "#2f6690", "tracker": "#8893a1", "oracle": "#8893a1"}
"""Of each play in the figure; one without is not drawn."""
_ANSWERS = {"before": "before", "after": "after", "tracker": "with a tracker's arm angles",
            "oracle": "with an oracle that knows what is wrong"}
"""How the answer tells each play; one without is in the table alone."""


@dataclass(frozen=True)
class Words:
    """Names, titles and captions in the report of ``close-loop`` for a kind of scene.

    Attributes:
        errors: key of the runs' errors in the JSON.
        error: name of a run's error, with its unit; ``judged``: name of the deciding error.
        columns: titles of the table of runs.
        as_it_was: name of the run with the original model.
        caption, decides: caption of the table of runs, and description of the deciding error.
        axes: titles of the figure's axes, and its caption; none without a figure.
    """

    errors: str
    error: str
    judged: str
    columns: tuple[str, ...]
    as_it_was: str
    caption: str
    decides: str
    axes: tuple[str, str, str] | None = None


@dataclass(frozen=True)
class Played:
    """True errors of one run, which a real cell does not know.

    Attributes:
        errors: of the simulated world, as the kind of scene has them.
        error: error by which runs are compared, in the unit of the report.
        row: of the table, the model's name first.
        json: the errors.
        curve: error over the motion, ``(N,)`` and ``(N,)`` as they are drawn; none without a figure.
    """

    errors: Any
    error: float
    row: list[Any]
    json: dict[str, Any]
    curve: tuple[Array, Array] | None = None


@dataclass(frozen=True, repr=False)
class Closing(ShownTable):
    """The result of ``close-loop``: a model that is extended by what a diagnosis finds, and its runs.

    Attributes:
        undeclared: effects that the world holds and the model does not know.
        plays: runs with the original model (``before``), with the extended one (``after``) and with the true one
            (``oracle``); others by the kind of scene.
        closed: extended model, every trial, and the findings.
        recordings: file name → recording to be written; the first one is that of the first diagnosis.
        more: further entries of the JSON.
        section: adds a section of its own to the page.
    """

    scene: Scene
    undeclared: tuple[Place, ...]
    plays: dict[str, Played]
    closed: Closed[Any] = field(repr=False)
    words: Words = field(repr=False)
    recordings: dict[str, Recording] = field(repr=False)
    more: dict[str, Any] = field(repr=False, default_factory=dict)
    section: Callable[[Report], None] = field(repr=False, default=lambda page: None)
    model_path: Path | None = None
    report: Path | None = None

    @property
    def errors(self) -> dict[str, Any]:
        """True errors of each run."""
        return {name: played.errors for name, played in self.plays.items()}

    @property
    def steps(self) -> tuple[Step, ...]:
        """Every change that was tried, with its deciding error and the reason of a rejection."""
        return tuple(self.closed.steps)

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The first diagnosis; None where the missing part of the model was measured instead."""
        return self.closed.found[0].diagnosis

    def refusals(self) -> list[str]:
        """One sentence for each diagnosed effect that is not kept."""
        stay = {place for step in self.steps if step.taken for place in step.places}
        why = {place: step.refused for step in self.steps if not step.taken for place in step.places}
        named = dict.fromkeys(place for finding in self.closed.found if finding.diagnosis
                              for place in places_of([effect.fitted for effect in finding.diagnosis.effects]))
        otherwise = f"a scene of kind {self.scene.kind} does not close it"
        return [f"{said(*place)} named, refused: {why.get(place, otherwise)}" for place in named if place not in stay]

    def answer(self) -> str:
        """What was hidden, what is kept in the model, and the error before and after, in a sentence or two."""
        hidden = " and ".join(said(*place) for place in self.undeclared)
        places = dict.fromkeys(place for step in self.steps if step.taken for place in step.places)
        # A change that only fits parameters anew adds no effect.
        anew = dict.fromkeys(step.tried for step in self.steps if step.taken and not step.places)
        kept = [*(said(*place) for place in places), *anew]
        errors = ", ".join(f"{self.plays[name].error:.3g} {words}" for name, words in _ANSWERS.items()
                           if name in self.plays)
        return (f"{self.words.error}: {errors}. Found and kept: "
                f"{' and '.join(kept) or 'nothing, the model is as it was'}. Hidden in the simulated arm: "
                f"{hidden or 'nothing that has a name'}.")

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        diagnosis = {} if self.diagnosis is None else {"diagnosis": self.diagnosis.to_dict()}
        steps = [{"round": step.round, "tried": step.tried, "taken": step.taken, "refused": step.refused or None,
                  "error": self.closed.subject.scale * step.error} for step in self.steps]
        values: dict[str, Any] = plain({
            **self.scene.played(), "undeclared": [{"effect": name, "joint": joint} for name, joint in self.undeclared],
            self.words.errors: {name: played.json for name, played in self.plays.items()}, "steps": steps,
            "refused": self.refusals(), "plan": None,
            "after_over_oracle": self.plays["after"].error / self.plays["oracle"].error, **diagnosis, **self.more,
            "model": self.model_path, "report": self.report})
        return values

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """The table of runs: titles, and one row per model."""
        return list(self.words.columns), [played.row for played in self.plays.values()]

    def ladder(self) -> tuple[tuple[str, ...], list[list[Any]]]:
        """The table of trials: titles, and one row per change of the model."""
        scale = self.closed.subject.scale
        return ("round", "change of the model", "stays", self.words.judged, "why not"), [
            [0, self.words.as_it_was, "yes", scale * self.closed.first, ""],
            *[[step.round, step.tried, "yes" if step.taken else "no", scale * step.error, step.refused]
              for step in self.steps]]

    def page(self) -> Report:
        """The HTML page of the result."""
        page = Report(f"{self.scene.title or self.scene.name}: the loop closed", self.answer())
        page.heading("Before and after")
        page.table(*self.table(), self.words.caption)
        if self.words.axes is not None:
            page.figure(self._curves(*self.words.axes[:2]), self.words.axes[2])
        if self.closed.model is not None and self.scene.kind in ("line", "force"):
            page.next((f'Play the scene with the extended model: a scene file beside this page with model = "{MODEL}".',
                       f"ideal-robot run my_{self.scene.name}.toml"))
        elif self.closed.model is not None:
            page.next(("Correct a path with the extended model, which is beside this page.",
                       f"ideal-robot precorrect PATH.csv --robot {self.scene.robot} --model {MODEL} -o corrected.csv"))
        page.heading("What was tried, and what stays", folded=True)
        page.table(*self.ladder(),
                   f"{self.words.decides} A change stays where it falls by more than one standard error: of its "
                   "scatter along the motion and from play to play.")
        if refusals := self.refusals():
            page.table(["what a diagnosis names and the model does not get"], [[refused] for refused in refusals])
        self.section(page)
        if self.diagnosis is not None:
            page.heading("The first diagnosis")
            page.text(summary(self.diagnosis))
            add_diagnosis(page, self.diagnosis)
        return page

    def _curves(self, abscissa: str, ordinate: str) -> Figure:
        figure = Figure(figsize=(4.6, 2.8), layout="constrained")
        axes = figure.subplots()
        for name, played in self.plays.items():
            if played.curve is not None and name in _COLOURS:
                # Dashed, so that the curve below it stays visible.
                axes.plot(*played.curve, "--" if name == "oracle" else "-", color=_COLOURS[name], lw=1.1, label=name)
        axes.set(xlabel=abscissa, ylabel=ordinate)
        # The legend stands above the picture, where it covers no curve.
        axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        axes.grid(alpha=0.3)
        return figure

    def written(self, folder: Path | None) -> Closing:
        """The result with its files written into a folder at once; without a folder the result alone."""
        if folder is None:
            return self
        page = self.page()
        with whole_folder(folder) as new:
            for name, recording in self.recordings.items():
                recording.write(new / name)
            self.closed.model.save(new / MODEL)
            page.write(new / "report.html")
        return dataclasses.replace(self, model_path=folder / MODEL, report=folder / "report.html")


# Parts of ``close-loop`` that kinds of scenes share: measurements of the arm, a motion at several speeds, and the
# measured tool position.

_STEPS = 80
"""Cycles of the way from the end of one speed to the start of the next."""


def at_speeds(motion: Array, slownesses: tuple[float, ...]) -> Array:
    """A joint motion ``(N, n)`` [rad] at several speeds, one after the other ``(M, n)`` [rad]."""
    rows = np.arange(len(motion))
    parts = [interpolated(np.arange(0.0, len(motion) - 1, 1.0 / slowness), rows, motion) for slowness in slownesses]
    ease = eased(np.linspace(0.0, 1.0, _STEPS)[:, None])
    return np.concatenate([parts[0], *[np.concatenate([a[-1] + (b[0] - a[-1]) * ease, b]) for a, b in pairwise(parts)]])


def tool_deviation(recording: Recording, wanted: tuple[Array, Array, Array], robot: Robot, known: Model,
                   loads: tuple[FittedEffect, ...] = (), doubt: float = 0.0) -> Array:
    """Deviation of the tool from its desired place, aligned, as the arm itself measures it ``(N,)`` [m].

    The tool's place where it is recorded, else that of the arm angles. Motor angles alone are converted to arm angles
    with the stiffness known before, so that a changed stiffness cannot confirm itself; the gear torques from the
    currents are used.

    Args:
        recording: the measured recording.
        wanted: instants ``(M,)`` [s] one cycle apart, joint angles at them ``(M, n)`` [rad], and which are used
            ``(M,)``.
        robot: kinematics as drawn.
        known: the model of before.
        loads: additional gear torques of the tried model.
        doubt: relative increase of the deflection by these torques.
    """
    t, q_d, counts = wanted
    x = measured_places(recording, (t, q_d), robot, known, loads, doubt)
    return path_errors(t[counts], robot.tool_places(q_d[counts]), recording.t, x).aligned.deviation


def measured_places(recording: Recording, wanted: tuple[Array, Array], robot: Robot, known: Model,
                    loads: tuple[FittedEffect, ...] = (), doubt: float = 0.0) -> Array:
    """Places of the tool as the arm itself measures them ``(N, 3)`` [m].

    Args:
        recording: the measured recording.
        wanted: instants ``(M,)`` [s] one cycle apart, and joint angles at them ``(M, n)`` [rad].
        robot, known, loads, doubt: as in ``tool_deviation``.
    """
    t, q_d = wanted
    if all(axis in recording.columns for axis in "xyz"):
        return np.column_stack([recording.columns[axis] for axis in "xyz"])
    if recording.has("qa"):
        return robot.tool_places(recording.joints("qa"))
    bent = _deflections(known, t, q_d, recording.t)
    if loads:
        bent = bent + (1.0 + doubt) * (_deflections(known.with_effects(loads), t, q_d, recording.t) - bent)
    return robot.tool_places(recording.joints("q") - bent)


def _deflections(model: Model, t: Array, q_d: Array, at: Array) -> Array:
    """Deflection of the gears ``(M, n)`` [rad] at times ``(M,)`` [s], as a model expects it along a motion."""
    gears = GearDeflection(model, float(t[1] - t[0]))
    return interpolated(at, t, gears.along(np.concatenate([q_d[:1], q_d, q_d[-1:]]))[1:-1])


Measured = Literal["motor", "arm", "tcp"]
"""Motor angles and currents only; arm angles too; the tool's place too."""
_PLACE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_HIDDEN = {"motor": _PLACE, "arm": _PLACE, "tcp": ()}


def visible(recording: Recording, measured: Measured) -> Recording:
    """The columns of a full recording that such an arm measures."""
    columns = {name: values for name, values in recording.columns.items()
               if name not in _HIDDEN[measured] and not (measured == "motor" and name.startswith("qa_"))}
    return Recording(columns, recording.meta, recording.source)


def checked_measured(value: str) -> Measured:
    """Checks the command line's word for what the arm measures, and returns it.

    Raises:
        InputError: another word than motor, arm and tcp.
    """
    if value not in _HIDDEN:
        raise InputError("expected motor, arm or tcp", field="--measured", value=value)
    return cast(Measured, value)
