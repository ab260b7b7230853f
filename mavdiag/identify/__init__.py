"""System identification: from commanded and measured rates to a model of the healthy airframe (T 4.1, 5.4).

>>> from mavdiag.identify import fit
"""

from mavdiag.identify.estimate import fit
from mavdiag.identify.model import ArxModel, Method, ModelRecord, Order

__all__ = ["ArxModel", "Method", "ModelRecord", "Order", "fit"]
