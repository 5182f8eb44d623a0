from numpy import *  # noqa: F403
from numpy import linalg as linalg
from numpy import ma as ma
from numpy import random as random
from numpy.typing import ArrayLike as ArrayLike
from numpy.typing import NDArray as NDArray
