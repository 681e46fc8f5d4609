"""The drive data file of a robot (TOML), checked: types, lengths and ranges of what stands in it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_toml
from ideal_robot.errors import InputError

Number = Annotated[float, pydantic.Field(strict=True, allow_inf_nan=False)]
Size = Annotated[float, pydantic.Field(strict=True, gt=0, le=1e9)]
NotNegative = Annotated[float, pydantic.Field(strict=True, ge=0, le=1e9)]
Cycle = Annotated[float, pydantic.Field(strict=True, ge=1e-5, le=1.0)]
Text = Annotated[str, pydantic.Field(strict=True, min_length=1, max_length=100)]


class _Table(pydantic.BaseModel):
    # Further keys are kept: other readers (RSI, users' programs) have their own tables here.
    model_config = pydantic.ConfigDict(extra="allow", frozen=True)


class Joints(_Table):
    """One number for all joints or a list with one each; on the motor side, as data sheets have it."""

    gear_ratio: Size | list[Size] = 1.0
    rotor_inertia: NotNegative | list[NotNegative] = 0.0
    torque_constant: Size | list[Size] = 1.0
    a_max: Size | list[Size] = float("inf")
    home: Number | list[Number] = 0.0


class Controller(_Table):
    """Cycle times [s]."""

    t_ipo: Cycle = 0.012
    t_position: Cycle = 0.002
    t_velocity: Cycle = 0.0005


class DriveData(_Table):
    """What a URDF lacks; every key may be missing."""

    name: Text | None = None
    tool_frame: Text | None = None
    joints: Joints = Joints()
    controller: Controller = Controller()

    def per_joint(self, key: str, n: int, file: Path | None) -> Array:
        """The value of a key of ``[joints]`` for every joint ``(n,)``.

        Args:
            key: of the table.
            n: number of joints.
            file: for the message.

        Raises:
            InputError: a list of another length.
        """
        given = getattr(self.joints, key)
        array = np.full(n, float(given)) if isinstance(given, (int, float)) else np.array(given, dtype=float)
        if array.shape != (n,):
            raise InputError(f"expected {n} numbers, one per joint, got {len(array)}", file=file,
                             field=f"joints.{key}")
        return array


def read_drive_data(path: Path | None) -> tuple[DriveData, dict[str, Any]]:
    """The checked data of a file and all that stands in it; neutral values without a file.

    Raises:
        InputError: not readable, a value of another type or out of range.
    """
    if path is None:
        return DriveData(), {}
    values = read_toml(path, "a robot data file")
    try:
        return DriveData(**values), values
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"] if not (isinstance(part, str) and "[" in part))
        shown = first.get("input")
        raise InputError(first["msg"], file=path, field=key.removesuffix(".float").removesuffix(".constrained-float"),
                         value=shown if isinstance(shown, (str, int, float)) else None) from error
