"""What files that others wrote may hold at most: one table, looked at before memory is taken for what a file claims.

Small files can unfold to large ones: a chunk of zeros, a row of a million commas, a list of empty lists. So a reader
counts first, in the packed file or piece by piece, and refuses with the numbers that stand here (docs/security.md).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ideal_robot.errors import InputError


class Limit(NamedTuple):
    """A row of the table.

    Attributes:
        most: so many at most.
        what: of what.
        why: what it leaves room for.
    """

    most: int
    what: str
    why: str

    def check(self, count: float, file: str | Path | None, remedy: str = "") -> None:
        """Refuses more than ``most``.

        Args:
            count: how many a file holds, or claims to.
            file: for the message.
            remedy: what helps.

        Raises:
            InputError: there are more.
        """
        if count > self.most:
            raise InputError(f"holds {count:.0f} {self.what}; at most {self.most} are read"
                             + (f": {remedy}" if remedy else ""), file=file)


JSON_BYTES = Limit(50_000_000, "bytes of a model or another JSON file", "a model of 30 joints takes 2 MB")
JSON_VALUES = Limit(2_000_000, "values of a JSON or TOML file", "they take 0.2 GB and ten seconds")
JSON_DEPTH = Limit(30, "levels of lists and tables", "models have five")
TOML_BYTES = Limit(2_000_000, "bytes of a scene or drive data", "the longest shipped one has 2 kB")
URDF_BYTES = Limit(20_000_000, "bytes of a URDF", "shipped ones have up to 12 kB")
URDF_ELEMENTS = Limit(20_000, "elements of a URDF", "shipped ones have up to 295")
URDF_DEPTH = Limit(30, "levels of a URDF", "a URDF has five")
URDF_JOINTS = Limit(40, "moving joints", "identification's matrices grow with their square")
SVG_BYTES = Limit(5_000_000, "bytes of an SVG file", "a path of 200,000 characters is the longest read")
SVG_ELEMENTS = Limit(50_000, "elements of an SVG file before its path", "without a path they take two seconds")
SVG_DEPTH = Limit(100, "levels of an SVG file", "groups of groups of a drawing program")
RSI_BYTES = Limit(65_536, "bytes of an RSI configuration", "a controller's has two to six thousand")
TABLE_VALUES = Limit(400_000_000, "values of a table", "four hours of 50 columns at 500 Hz, 3.2 GB on the disk")
TABLE_COLUMNS = Limit(5_000, "columns of a table", "a recording of six joints has up to 80")
TABLE_LINE = Limit(1_000_000, "bytes of a line of a CSV file", "5,000 columns of 25 characters take 125 kB")
TABLE_WORDS = Limit(20_000_000, "bytes of a recording's metadata", "a model within takes 2 MB")
TABLE_UNFOLDING = Limit(50, "times the size of a Parquet file, beyond 160 MB",
                        "columns of zeros take nothing, times and positions do not compress")
BAG_UNFOLDING = Limit(20, "times the size of a bag, beyond 64 MB", "500,000 messages of a joint pass in any case")
BAG_MESSAGE = Limit(100_000, "bytes of a message of joint states, or of a definition", "30 joints take 2 kB")
BAG_WORDS = Limit(1_000_000, "bytes of a bag's metadata.yaml", "a topic takes half a kilobyte")
PICTURE_PIXELS = Limit(64_000_000, "pixels of a picture", "8000 × 8000")
REPLAY_BYTES = Limit(200_000_000, "bytes of an unpacked replay", "that of a shipped line takes 0.4 MB")
ALL = tuple(value for value in list(globals().values()) if isinstance(value, Limit))
_FREE = {TABLE_UNFOLDING: 160_000_000, BAG_UNFOLDING: 64_000_000}


def check_unfolding(limit: Limit, unpacked: float, packed: float, file: Path) -> None:
    """Refuses a file that unfolds to far more than its size.

    Args:
        limit: ``TABLE_UNFOLDING`` or ``BAG_UNFOLDING``.
        unpacked: what it unpacks to [bytes].
        packed: its size [bytes].
        file: for the message.

    Raises:
        InputError: it does.
    """
    if unpacked > _FREE[limit] + limit.most * packed:
        raise InputError(f"unfolds to more than {_FREE[limit] / 1e6:.0f} MB and {limit.most} times its size; write it "
                         "without compression, or cut it into pieces", file=file)
