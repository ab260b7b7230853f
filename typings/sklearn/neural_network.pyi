from typing import Self

import numpy as np
from numpy.typing import NDArray

class MLPClassifier:
    classes_: NDArray[np.int64]
    def __init__(
        self,
        hidden_layer_sizes: tuple[int, ...] = ...,
        *,
        alpha: float = ...,
        max_iter: int = ...,
        early_stopping: bool = ...,
        random_state: int | None = ...,
    ) -> None: ...
    def fit(self, X: NDArray[np.float64], y: NDArray[np.int64]) -> Self: ...
    def predict_proba(self, X: NDArray[np.float64]) -> NDArray[np.float64]: ...
