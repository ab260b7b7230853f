"""System identification: from commanded and measured rates to a model of the healthy airframe (T 4.1, 5.4).

The package itself can be called, which is `fit`: `import mavdiag as md; md.identify(u, y, dt=0.01)`.
"""

import sys
from types import ModuleType

from mavdiag.identify.arx import ArxModel as ArxModel
from mavdiag.identify.arx import Method as Method
from mavdiag.identify.arx import ModelRecord as ModelRecord
from mavdiag.identify.arx import Order as Order
from mavdiag.identify.estimate import fit as fit


class _CallablePackage(ModuleType):
    __call__ = staticmethod(fit)  # type checkers do not see it: typed code calls `fit`


sys.modules[__name__].__class__ = _CallablePackage
