"""What once broke the program, replayed: each is mended, or ends in one line."""

from __future__ import annotations

import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest import mock

import numpy as np
import typer
from numba.core.caching import IndexDataCacheFile
from rosbags.rosbag2.storage_mcap import zstd

from ideal_robot.errors import IdealRobotError
from ideal_robot.rsi.message import RsiFormat
from ideal_robot.rtde import RtdeRobot
from ideal_robot.signals.recording import Recording
from planning.force.contact import most_force
from scenes import workers
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from studies.report import head, row, scene_of
from tests.fuzz import mutate, originals
from tests.fuzz.cases import ARM, URDF
from tests.fuzz.play import Case, play
from tests.ideal_robot import test_jit
from tests.ideal_robot.rtde.test_rtde import ROBOT, connected, until
from tests.ideal_robot.test_file_limits import chunk, mcap
from tests.scenes.follow.eye_on_bench import followed as followed_by_eye
from tests.scenes.follow.eye_on_bench import shaken, shifted
from tests.scenes.follow.on_bench import FAULTS, followed
from tests.scenes.rsi.test_faults import HOME, played
from tests.scenes.test_sweep import swept_until_the_scheduler_dies
from tests.sim.devices import test_controllers as clients
from tests.sim.devices.controllers import LaggingController

Replay = tuple[str, str, bool]
"""What was tried, what came of it, and whether it is as promised."""
LOSS = 0.02
"""Share of answers that are lost, and as many that come late."""


def deaf_sensor(folder: Path) -> Iterator[Replay]:
    """A force sensor that feels nothing."""
    scene = scene_of(ForceScene, "force_wave")
    for stage in ("turning", "search", "press", "travel"):
        run = followed(scene, folder / stage, spoil=FAULTS["nothing but noise of 0.3 mN"](), stage=stage)
        yield (f"feels nothing but 0.3 mN of noise, from the {stage} on",
               f"{run.force:.0f} N on the surface; {run.failure}",
               run.failure is not None and run.force <= most_force(scene.force))


def standing_clock(folder: Path) -> Iterator[Replay]:
    """RTDE whose time stamps do not go on."""
    begun = time.monotonic()
    with connected(timeout=0.02, patience=5.0, clock_stands=30) as (link, _):
        message = _said(lambda: until(link))
    yield "time stamps stand still", f"{message} ({time.monotonic() - begun:.0f} s)", "do not go on" in message


def dead_scheduler(folder: Path) -> Iterator[Replay]:
    """A cluster that loses its scheduler."""
    with mock.patch.object(workers, "PATIENCE", 20.0):
        rows, lines = swept_until_the_scheduler_dies(folder)
    kept = len(lines.read_text().splitlines())
    lost = sum("not_played" in entry for entry in rows)
    yield "killed after the first of three runs", f"{kept} answer kept, {lost} not played", (kept, lost) == (1, 2)


def beside_the_line(folder: Path) -> Iterator[Replay]:
    """What was silently beside the line, and recordings that cannot be."""
    line = scene_of(LineScene, "line")
    for fault, spoilt in (("stamps within 50 ms", {"stamp": shaken(0.05)}),
                          ("pictures moved by 8 pixels", {"picture": shifted(8)}),
                          ("pictures moved by 40 pixels", {"picture": shifted(40)})):
        run = followed_by_eye(line, folder, **spoilt)
        yield (fault, f"{1e3 * run.beside.max(initial=0.0):.2f} mm beside the line; {run.failure}",
               run.failure is not None and run.beside.max(initial=0.0) < 1e-3)
    columns = originals.motion(folder)
    half = np.array(columns["tau_1"])
    half[len(half) // 2 :] = half[len(half) // 2]
    for fault, torque in (("a torque channel stuck for half of the recording", half),
                          ("a torque channel a thousand times too large", 1e3 * columns["tau_1"])):
        raw = mutate.csv_bytes({**columns, "tau_1": torque})
        yield _verb(fault, f"identify r.csv {URDF} --friction viscous_coulomb --out o", folder, {"r.csv": raw}, ARM)


def compiled_code(folder: Path) -> Iterator[Replay]:
    """Compiled code that is damaged or cannot be written."""
    source = folder / "compiled_here.py"
    source.write_text(test_jit.SOURCE, encoding="utf-8")
    with mock.patch("numba.core.config.CACHE_DIR", ""):
        test_jit.loaded(source).doubled(3)
        for index in (*(folder / "__pycache__").glob("*.nbi"), *test_jit.kept(source)):
            index.write_bytes(index.read_bytes()[:20])
        doubled = test_jit.loaded(source).doubled(5)
        yield "index and code cut off", f"compiled again, 2 × 5 = {doubled}", doubled == 10
        with mock.patch.object(IndexDataCacheFile, "_open_for_write", test_jit.refuse), mock.patch(
                "tempfile.TemporaryFile", test_jit.refuse):
            module = test_jit.loaded(source)
            doubled, hits = module.doubled(4), test_jit.hits(module)
        yield "nothing can be written", f"2 × 4 = {doubled} with the code that is there: {hits} hit", doubled == 8


def unfolding_files(folder: Path) -> Iterator[Replay]:
    """Small files that unfold."""
    zeros = bytes(3_000_000_000 // 3)
    bag = mcap(folder / "z.mcap", chunk(zeros, zstd.compress(zeros), "zstd")).read_bytes()
    identify = f"{URDF} --friction viscous_coulomb --out o"
    del zeros
    yield _verb(f"a bag of {len(bag) // 1000} kB: a chunk of 1 GB of zeros", f"identify r.mcap {identify}", folder,
                {"r.mcap": bag}, ARM)
    yield _verb("a CSV row of 20 MB", f"identify r.csv {identify}", folder,
                {"r.csv": b"t,q_1\n" + b"1," * 10_000_000 + b"1\n"}, ARM)
    yield _verb("a model of 48 MB: empty lists", "precorrect path.csv --model m.json -o c.csv --out o", folder,
                {"m.json": b"[" + b"[]," * 16_000_000 + b"1]"}, ("path.csv",))


def other_clients(folder: Path) -> Iterator[Replay]:
    """RTDE as others speak it."""
    texts = {"garbage": b"\0\0V", "a rate that is none": clients.package("O", struct.pack(">d", np.nan) + b"timestamp"),
             "9,000 fields": clients.package("O", struct.pack(">d", 125.0) + ",".join(map(str, range(9000))).encode()),
             "registers cut off": clients.AGREED + clients.package("U", b"\1" + bytes(20)),
             "another recipe": clients.AGREED + clients.command(*ROBOT.home, recipe=2)}
    with clients.served() as (cell, _):
        gone = [clients.ended(cell.address, text) for text in texts.values()]
        with RtdeRobot(ROBOT, *cell.address[:1], port=cell.address[1], timeout=5.0) as robot:
            robot.connect(5.0)
            for k in range(8):
                robot.cycle(ROBOT.home + 0.001 * k)
    yield f"malformed clients: {', '.join(texts)}", f"{sum(gone)} of {len(gone)} let go, the next is served", all(gone)
    with clients.served() as (cell, sessions), clients.socket.create_connection(cell.address, 10.0) as client:
        client.sendall(clients.AGREED + clients.command(*(ROBOT.home + 1e-4)))
        while cell.arm.t == 0.0:
            time.sleep(0.001)
        client.sendall(clients.command(*[np.nan] * 6, number=2))
        while not sessions:
            time.sleep(0.01)
    yield "a command of NaN", sessions[0].ended, "refuses" in sessions[0].ended
    with connected(program_begins=20) as (link, controller):
        until(link)
        count = len(controller.commands)
    yield "the program is started after 20 cycles", f"led on, {count} commands", count > 90


def lost_answers(folder: Path) -> Iterator[Replay]:
    """Late and lost answers at 12 ms."""
    rng = np.random.default_rng(1)
    lost, late = (rng.random((2, 10_000)) < LOSS)
    for name, adds_up, goes_on in (("absolute", False, False), ("relative, held on", True, True)):
        controller = LaggingController(HOME, adds_up=adds_up, goes_on=goes_on, lost=lambda k: k > 20 and bool(lost[k]),
                                       late=lambda k: k > 20 and bool(late[k]))
        run = played(folder, controller, relative=adds_up, method="ideal", form=RsiFormat(hold_on=True))
        speed = np.diff(np.radians(controller.commanded), axis=0) / controller.cycle
        share = np.abs(np.diff(speed, axis=0)) / controller.cycle / ROBOT.a_max
        # A controller that holds stops the arm at once by itself.
        ours = float((share * (np.abs(speed[1:]) > 1e-12)).max())
        yield (f"{1e2 * LOSS:.0f} % lost and {1e2 * LOSS:.0f} % late, {name}",
               f"acceleration at the controller up to {share.max():.2f} of the arm's, {ours:.2f} without its own "
               f"holding; {run.failure or 'path complete'}", run.failure is None and ours <= 1.0)


def small_things(folder: Path) -> Iterator[Replay]:
    """What ended without a remedy."""
    yield _verb("follow --cycle 0", "follow ideal_line.toml --arm rsi://127.0.0.1:41999 --camera file:f.avi --cycle 0",
                folder, {}, ("ideal_line.toml",))
    exported = folder / "e.csv"
    Recording({"t": np.arange(3.0), "=1+1|cmd": np.zeros(3)}).write(exported)
    title = exported.read_text().splitlines()[0].split(",")[-1]
    yield "a column called =1+1|cmd, exported", f"its title is {title}", not title.startswith("=")


FINDINGS: dict[str, Callable[[Path], Iterator[Replay]]] = {
    "deaf-sensor": deaf_sensor, "standing-clock": standing_clock, "dead-scheduler": dead_scheduler,
    "beside-the-line": beside_the_line, "compiled-code": compiled_code, "unfolding-files": unfolding_files,
    "other-clients": other_clients, "lost-answers": lost_answers, "small-things": small_things,
}


def findings(only: str = ",".join(FINDINGS)) -> None:
    """What once broke the program, replayed: what is tried, what comes of it, and whether it is as promised.

    Exit code 1 where one is not.
    """
    broken = 0
    head("finding", "tried", "what comes of it", "as promised")
    for name in only.split(","):
        with tempfile.TemporaryDirectory(prefix="finding-") as folder:
            for tried, came, sound in FINDINGS[name](Path(folder)):
                broken += not sound
                title = (FINDINGS[name].__doc__ or "").rstrip(".")
                row(title, tried, came.replace("|", "\\|"), "yes" if sound else "NO")
    raise typer.Exit(bool(broken))


def _verb(tried: str, words: str, folder: Path, files: dict[str, bytes], sound: tuple[str, ...]) -> Replay:
    """A verb in a process of its own: one line, exit code 2 or a warning, no traceback, within a minute and 2 GB.

    Args:
        tried: what is wrong.
        words: of the command line.
        folder: for sound files.
        files: that are not.
        sound: names of those that are.
    """
    outcome = play(Case(tried, words.split(), {**files, **{name: originals.sound(name, folder) for name in sound}}))
    message = " ".join(outcome.err.split())[:200]
    return (tried, f"exit code {outcome.code}, {outcome.seconds:.1f} s, {outcome.peak / 1e9:.2f} GB: {message}",
            outcome.broken is None and (outcome.code == 2 or bool(message)))


def _said(work: Callable[[], object]) -> str:
    """What ends the work."""
    try:
        work()
    except IdealRobotError as error:
        return str(error)
    return "nothing"
