"""What the arrays of studies hold; their shapes stand beside them."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # of any shape
Vector = NDArray[np.float64]  # (n,)
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Places = NDArray[np.int64]  # where in an array
Rows = NDArray[np.intp]  # the same, as numpy's own search gives them
