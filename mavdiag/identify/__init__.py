"""System identification: from commanded and measured rates to a model of the healthy airframe (T 4.1, 5.4).

>>> from mavdiag.identify import fit

The package itself can be called, which is `fit`: `import mavdiag as md; md.identify(u, y, dt=0.01)`.
"""

import sys
from types import ModuleType
from typing import Any

from mavdiag.identify.estimate import fit
from mavdiag.identify.model import ArxModel, Method, ModelRecord, Order

__all__ = ["ArxModel", "Method", "ModelRecord", "Order", "fit"]


class _CallablePackage(ModuleType):
    """This package, with a call. Type checkers do not see it: typed code calls `fit`."""

    def __call__(self, *args: Any, **kwargs: Any) -> ArxModel:
        """As `fit`."""
        return fit(*args, **kwargs)


sys.modules[__name__].__class__ = _CallablePackage
