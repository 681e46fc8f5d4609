"""Cameras as devices: films, GenICam by its interface, and our own stream with a clock of its own."""

from __future__ import annotations

import struct
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ideal_robot.errors import InputError
from sensing import SensingError
from sensing.camera.cameras import Frame, GenICamCamera, StreamCamera, open_camera
from sensing.camera.video_capture import VideoCapture
from tests.sensing.camera import synthetic
from tests.sensing.stream.test_stream import device, package


def picture(k: int) -> np.ndarray:
    return np.full((48, 64), 40 + 10 * (k % 10), dtype=np.uint8)


@pytest.fixture(name="film")
def _film(tmp_path: Path) -> Path:
    return synthetic.film(tmp_path / "film.avi", map(picture, range(12)), 50.0)


def test_a_film_is_read_with_its_stamps_and_its_pace(film: Path) -> None:
    camera = open_camera(f"file:{film}")
    frames = [frame for _ in range(12) if (frame := camera.read(1.0)) is not None]
    assert (camera.width, camera.height, camera.stamps) == (64, 48, "stream")
    np.testing.assert_allclose(np.diff([frame.stamp for frame in frames]), 0.02, atol=1e-6)
    assert frames[-1].arrived - frames[0].arrived >= 0.02 * (len(frames) - 1) - 0.05
    assert [round(float(frame.image.mean()), -1) for frame in frames] == [float(picture(k).mean()) for k in range(12)]
    with pytest.raises(SensingError, match="no picture comes"):
        camera.read(1.0)
    camera.close()


def test_a_driver_without_stamps_is_said_to_have_none(film: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = VideoCapture(str(film))
    real = camera._capture

    class Silent:
        def get(self, what: int) -> float:
            return 0.0 if what == cv2.CAP_PROP_POS_MSEC else real.get(what)

        def __getattr__(self, name: str) -> Any:
            return getattr(real, name)

    monkeypatch.setattr(camera, "_capture", Silent())
    camera.read(1.0), camera.read(1.0)
    frame = camera.read(1.0)
    assert camera.stamps == "arrival"
    assert frame is not None
    assert frame.stamp == frame.arrived
    camera.close()


@pytest.mark.parametrize("address", ["usb:left", "file:nowhere.mp4", "ftp://there", "rtsp", "stream://127.0.0.1",
                                     "stream://127.0.0.1:99999", "stream://a:²", f"stream://a:{'1' * 5000}",
                                     "genicam:none.cti"])
def test_an_address_that_cannot_be_is_refused(address: str) -> None:
    with pytest.raises(InputError):
        open_camera(address)


class Part:
    def __init__(self, data: np.ndarray, data_format: str) -> None:
        self.height, self.width = data.shape
        self.data, self.data_format = data.ravel(), data_format


class Buffer:
    """What harvesters hands out: to be used within ``with``, then it goes back to the camera."""

    def __init__(self, part: Part, stamp: int) -> None:
        self.payload, self.timestamp_ns, self.queued = type("Payload", (), {"components": [part]}), stamp, False

    def __enter__(self) -> Buffer:
        return self

    def __exit__(self, *_: object) -> None:
        self.queued = True
        self.payload.components[0].data[:] = 0


class Acquirer:
    def __init__(self, data_format: str, scale: int) -> None:
        self.running, self.destroyed, self.k = False, False, 0
        self.data_format, self.scale = data_format, scale
        self.buffers: list[Buffer] = []

    def start(self) -> None:
        self.running = True

    def try_fetch(self, *, timeout: float) -> Buffer | None:
        self.k += 1
        if not self.running or self.k % 4 == 0:
            return None
        kind = np.uint8 if self.scale == 1 else np.uint16
        data = (picture(self.k).astype(kind) * self.scale).astype(kind)
        self.buffers.append(Buffer(Part(data, self.data_format), 10**15 + 20_000_000 * self.k))
        return self.buffers[-1]

    def stop(self) -> None:
        self.running = False

    def destroy(self) -> None:
        self.destroyed = True


@pytest.mark.parametrize(("data_format", "scale"), [("Mono8", 1), ("Mono12", 16), ("Mono16", 256)])
def test_genicam_by_the_interface_of_harvesters(data_format: str, scale: int) -> None:
    acquirer = Acquirer(data_format, scale)
    camera = GenICamCamera(acquirer)
    frames: list[Frame | None] = []
    for _ in range(7):
        time.sleep(0.02)
        frames.append(camera.read(0.1))
    sound = [frame for frame in frames if frame is not None]
    assert len(sound) == 5
    assert all(buffer.queued for buffer in acquirer.buffers)
    assert [int(frame.image[0, 0]) for frame in sound] == [picture(k)[0, 0] for k in (2, 3, 5, 6, 7)]
    assert sound[0].stamp == pytest.approx(1e6 + 0.04, abs=1e-6)
    camera.close()
    assert acquirer.destroyed


def test_genicam_formats_that_are_not_gray_are_refused_with_what_to_set() -> None:
    acquirer = Acquirer("BayerRG8", 1)
    with pytest.raises(InputError, match="Mono8"):
        GenICamCamera(acquirer)
    # Another program, or the next start, can open it.
    assert not acquirer.running
    assert acquirer.destroyed


def field(k: int, stamp: float, width: int = 64) -> bytes:
    return package(2, stamp, struct.pack(">IHH", k, width, 48) + picture(k).tobytes())


HELLO = package(1, 0.0, struct.pack(">HHd14d", 64, 48, 50.0, *([float("nan")] * 14)))


def test_a_stream_of_another_clock_is_translated_without_any_delay_given() -> None:
    def clock() -> float:
        return time.perf_counter() * (1 + 20e-6) - 5000.0

    # Each field is 40 ms old when it is sent: arrivals alone would be wrong by that.
    with device(HELLO, lambda k: field(k, clock() - 0.040), clock=clock) as (host, port):
        camera = StreamCamera(host, port)
        end, ages = time.perf_counter() + 1.2, []
        while time.perf_counter() < end:
            frame = camera.read(0.1)
            if frame is not None:
                ages.append(frame.arrived - camera.clock.host(frame.stamp))
        camera.close()
    assert (camera.width, camera.height, camera.rate) == (64, 48, 50.0)
    assert len(ages) > 30
    # A busy machine lets single fields wait, and the first questions to the clock; the soonest of the later ones tell.
    assert min(ages[len(ages) // 2:]) == pytest.approx(0.040, abs=0.003)


def test_questions_that_wait_at_the_device_do_not_shift_its_clock() -> None:
    questions = []

    def clock() -> float:
        questions.append(1)
        if len(questions) < 6:
            time.sleep(0.02)
        return time.perf_counter() - 5000.0

    with device(HELLO, lambda k: field(k, time.perf_counter() - 5000.0), clock=clock) as (host, port):
        camera = StreamCamera(host, port)
        end = time.perf_counter() + 1.2
        while time.perf_counter() < end:
            camera.read(0.1)
        now = time.perf_counter()
        error = camera.clock.host(now - 5000.0) - now
        camera.close()
    assert len(questions) > 8
    assert abs(error) < 0.003


def test_pictures_of_another_size_are_refused_and_a_camera_that_comes_back_goes_on() -> None:
    def message(k: int) -> bytes | None:
        return None if k == 10 else field(k, time.perf_counter(), width=63 if k == 5 else 64)

    with device(HELLO, message) as (host, port):
        camera = StreamCamera(host, port)
        end, numbers = time.perf_counter() + 1.5, []
        while time.perf_counter() < end and len(numbers) < 30:
            frame = camera.read(0.1)
            if frame is not None:
                numbers.append(frame.number)
        camera.close()
    assert max(numbers) > 15
    assert 5 not in numbers
    assert camera._connection.broken == 1


def test_a_force_sensor_is_no_camera() -> None:
    hello = package(3, 0.0, struct.pack(">d", 250.0))
    with device(hello, lambda k: package(4, 0.0, b"")) as (host, port), pytest.raises(InputError, match="camera"):
        StreamCamera(host, port, patience=0.5)


def test_what_opencv_says_of_a_broken_film_does_not_stand_beside_our_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str],
) -> None:
    """FFmpeg's complaint about the header, and that of OpenCV's own reader about a film of nothing."""
    film = synthetic.film(tmp_path / "film.avi", [np.zeros((120, 160), np.uint8)])
    raw = film.read_bytes()
    start = raw.find(b"JUNK")
    film.write_bytes(raw[:start] + b"\0\0\0L\xff\xff\xff\xf0" + raw[start + 8 :])
    VideoCapture(str(film)).close()
    film.write_bytes(raw[:12] + bytes(200))
    with pytest.raises(InputError):
        VideoCapture(str(film))
    assert capfd.readouterr().err == ""
