"""Arms as their makers describe them: kinematics, nominal inertias, drive data; and the list of shipped arms."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

from ideal_robot.errors import InputError

SHIPPED = ("kr6", "kr15", "manutec_r15", "kr500")


def urdf_of(name_or_urdf: str | Path) -> Path:
    """The URDF of a shipped robot, or the one at that path; raises InputError for neither, and for drive data."""
    if str(name_or_urdf) in SHIPPED:
        return Path(str(resources.files("ideal_robot"))) / "robots" / str(name_or_urdf) / f"{name_or_urdf}.urdf"
    urdf = Path(name_or_urdf)
    if urdf.suffix == ".toml":
        raise InputError("expected a shipped robot or a URDF; drive data (TOML) go to --drive-data", field="robot",
                         value=str(name_or_urdf))
    # Also for a name that is too long, where the system would raise another error.
    if not os.path.isfile(urdf):
        raise InputError(f"no such URDF file, nor a shipped robot; shipped are {', '.join(SHIPPED)}",
                         field="urdf", value=str(name_or_urdf))
    return urdf
