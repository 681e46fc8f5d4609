"""Public data sets: fetched from a server, checked, converted; nothing is written where anything is wrong."""

from __future__ import annotations

import hashlib
import threading
import zipfile
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.signals.recording import Recording
from scenes.data_sets import data_sets, fetch, values_hash
from tests.sources import DATA, free_port

ROWS = b"10.0,0.5,2.0\n10.1,0.6,-1.0\n10.2,0.7,3.0\n"


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *words: object) -> None:
        pass


@pytest.fixture
def served(tmp_path: Path) -> Iterator[str]:
    folder = tmp_path / "served"
    folder.mkdir()
    (folder / "arm.csv").write_bytes(ROWS)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    thread.join()
    server.server_close()


def registry(folder: Path, url: str, **more: str) -> Path:
    path = folder / "sets.toml"
    lines = {"title": "an arm", "page": "https://example.org", "cite": "Somebody (2020)", "licence": "CC BY 4.0",
             "url": url, **more}
    path.write_text("[arm]\n" + "".join(f'{key} = "{value}"\n' for key, value in lines.items())
                    + 'columns = ["t", "q_1", "current_1"]\nchecked = ["q_1"]\ntorque_of = { current_1 = 4.0 }\n')
    return path


def test_a_set_is_fetched_checked_and_becomes_a_recording(served: str, tmp_path: Path) -> None:
    path = fetch("arm", tmp_path / "out", registry=registry(tmp_path, f"{served}/arm.csv",
                                                            sha256=hashlib.sha256(ROWS).hexdigest()))
    recording = Recording.read(path)
    np.testing.assert_allclose(recording.t, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(recording.columns["tau_1"], [8.0, -4.0, 12.0])
    assert recording.meta["licence"] == "CC BY 4.0"
    assert "Somebody" in (tmp_path / "out" / "arm.txt").read_text()


@pytest.mark.parametrize("check", ["sha256", "values_sha256"])
def test_another_file_than_published_is_refused_and_not_written(served: str, tmp_path: Path, check: str) -> None:
    with pytest.raises(IdealRobotError, match="nothing was written"):
        fetch("arm", tmp_path / "out", registry=registry(tmp_path, f"{served}/arm.csv", **{check: "0" * 64}))
    assert not (tmp_path / "out").exists()


def test_without_a_connection_it_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(IdealRobotError, match=r"cannot be reached.*give it with --file"):
        fetch("arm", tmp_path / "out", registry=registry(tmp_path, f"http://127.0.0.1:{free_port()}/arm.csv"))


def test_a_missing_file_on_the_server_and_other_addresses_are_errors(served: str, tmp_path: Path) -> None:
    for name, url, error, says in (("arm", f"{served}/none.csv", IdealRobotError, "404"),
                                   ("arm", "file:///etc/hostname", InputError, "http"),
                                   ("arm", "", InputError, "--file"),
                                   ("leg", served, InputError, "expected one of arm")):
        with pytest.raises(error, match=says):
            fetch(name, tmp_path / "out", registry=registry(tmp_path, url))


def test_a_file_downloaded_by_hand_is_taken_and_nonsense_is_not(tmp_path: Path) -> None:
    sets = registry(tmp_path, "http://127.0.0.1:9/arm.csv")
    (tmp_path / "mine.csv").write_bytes(ROWS)
    assert fetch("arm", tmp_path / "out", file=tmp_path / "mine.csv", registry=sets).is_file()
    (tmp_path / "mine.csv").write_bytes(b"no,numbers\n")
    with pytest.raises(InputError, match="not readable"):
        fetch("arm", tmp_path / "out", file=tmp_path / "mine.csv", registry=sets)


def test_a_file_in_a_zip_is_taken_out_of_it_and_a_page_of_words_is_not_a_zip(served: str, tmp_path: Path) -> None:
    folder = tmp_path / "served"
    with zipfile.ZipFile(folder / "arm.zip", "w") as packed:
        packed.writestr("data/readme.txt", "words")
        packed.writestr("data/arm.csv", ROWS)
    (folder / "page.html").write_text("<html>too many visitors today</html>")
    (folder / "damaged.zip").write_bytes((folder / "arm.zip").read_bytes().replace(b"10.1,0.6", b"10.1,0.7"))
    path = fetch("arm", tmp_path / "out", registry=registry(tmp_path, f"{served}/arm.zip", member="arm.csv"))
    np.testing.assert_allclose(Recording.read(path).columns["q_1"], [0.5, 0.6, 0.7])
    with pytest.raises(InputError, match=r"a zip without leg\.csv"):
        fetch("arm", tmp_path / "no", registry=registry(tmp_path, f"{served}/arm.zip", member="leg.csv"))
    for broken in ("page.html", "damaged.zip"):
        with pytest.raises(InputError, match=r"https://example\.org"):
            fetch("arm", tmp_path / "no", registry=registry(tmp_path, f"{served}/{broken}", member="arm.csv"))
    assert not (tmp_path / "no").exists()


def test_every_shipped_set_has_licence_origin_and_checksum() -> None:
    for data_set in data_sets().values():
        assert data_set.licence
        assert data_set.cite
        assert data_set.page.startswith("https://")
        assert len(data_set.sha256 or data_set.values_sha256) == 64
        assert data_set.url.startswith("https://")


@pytest.mark.skipif(not DATA.is_dir(), reason="needs the public data sets beside the repository")
def test_the_checksums_are_those_of_the_recordings_the_documentation_uses(tmp_path: Path) -> None:
    """The original's form, made of the recording here, passes the check and gives the same columns."""
    sets = data_sets()
    here = Recording.read(DATA / "ur10e" / "ptp_10_points.parquet")
    data_set = sets["ur10e_ptp"]
    np.savetxt(tmp_path / "ur.csv", np.column_stack([here.columns[name] for name in data_set.columns]), fmt="%.4f",
               delimiter=",")
    again = Recording.read(fetch("ur10e_ptp", tmp_path, file=tmp_path / "ur.csv"))
    for name in here.columns:
        np.testing.assert_allclose(again.columns[name], here.columns[name], atol=1e-4)
    axis = Recording.read(DATA / "emps" / "emps_estimation.parquet")
    assert values_hash(dict(axis.columns), sets["emps"]) == sets["emps"].values_sha256
    savemat(tmp_path / "emps.mat", {"t": axis.t, "qm": axis.columns["q_1"], "qg": axis.columns["q_d_1"],
                                    "vir": axis.columns["tau_1"] / 35.15})
    assert fetch("emps", tmp_path, file=tmp_path / "emps.mat").is_file()
