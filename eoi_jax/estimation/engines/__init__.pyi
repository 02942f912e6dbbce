from .automatic import Automatic as Automatic
from .engine import AbstractEngine as AbstractEngine
from .engine import Lanes as Lanes
from .native import Native as Native
from .pallas import OneKernel as OneKernel
from .scan import Scan as Scan
