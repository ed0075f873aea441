"""Wall time of one stage after the other."""

from time import perf_counter


class Clock:
    """seconds  stage -> how long it took, since the stage before it"""

    def __init__(self) -> None:
        self.seconds, self._last = dict[str, float](), perf_counter()

    def lap(self, stage: str) -> None:
        now = perf_counter()
        self.seconds[stage], self._last = now - self._last, now
