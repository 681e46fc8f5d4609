"""The array type of the whole project."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Double precision, whatever the shape; the docstring of each function says which."""
