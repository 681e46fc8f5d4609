"""Model files of others: what does not fit together is refused with its key."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ideal_robot.errors import InputError
from ideal_robot.model.model import Model

SHIPPED = Path(__file__).resolve().parents[3] / "scenes" / "models" / "kr6.json"


def _set(values: Any, path: str, new: Any) -> None:
    *parts, last = (int(part) if part.isdigit() else part for part in path.split("/"))
    for part in parts:
        values = values[part]
    values[last] = new


@pytest.mark.parametrize(("path", "new"), [
    ("controller/delay", None), ("controller/delay", "soon"), ("controller/k_p", [1.0]), ("controller/k_p", 3.0),
    ("controller/filter_order", 2.5), ("controller/t_cycle", 0.0), ("controller/k_i/0", None), ("controller", [1]),
    ("base/values/0", None), ("base/values", [1.0]), ("base/grouping", [[1.0]]), ("base/grouping/0/0", None),
    ("base/independent/0", 9999), ("base/independent/0", "a"), ("base/full_names", ["a"]), ("base/gravitational", [1]),
    ("friction", []), ("friction/0/coefficients/0", [None]), ("friction/0/law", "magic"), ("friction/0/law", [1]),
    ("friction/0/shape", "x"), ("covariance", [[0.0]]), ("covariance", None), ("noise_std", [1.0] * 7),
    ("consistent", "text"), ("stiffness", [0.0] * 6), ("stiffness", [1.0]), ("robot/urdf", "<robot/>"),
    ("robot/urdf", None), ("robot/name", "[/red]\x1b"), ("effects", [{}]), ("effects", 3), ("effects", [3]),
    ("effects", [{"name": "unknown", "joint": 1, "coefficients": [1.0], "data": {}}]),
    ("effects", [{"name": "torque_ripple", "joint": 1, "channel": "tau_1", "coefficients": [1.0], "theta": [250.0]}]),
    ("effects", [{"name": "gear_elasticity", "joint": 99, "coefficients": [1.0], "channel": "qa_99"}]),
    ("provenance", 3), ("schema", "1"), ("schema", 99), ("schema", True),
])
def test_a_model_that_does_not_fit_together_is_refused(path: str, new: Any, tmp_path: Path) -> None:
    values = json.loads(SHIPPED.read_text())
    _set(values, path, new)
    file = tmp_path / "model.json"
    file.write_text(json.dumps(values))
    with pytest.raises(InputError) as refused:
        Model.load(file)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 1000


@pytest.mark.parametrize("text", ["", "[" * 100_000, '{"a":' * 100_000, "nan", "3", "[]", "{}", '{"schema": 1}', "\0",
                                  '{"schema": 1e999}', '{"schema": NaN}', '{"schema": ' + "9" * 5000 + "}"])
def test_what_is_no_model_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "model.json"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        Model.load(file)
    assert refused.value.file == file
