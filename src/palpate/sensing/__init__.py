"""The loop in real time: a source of frames, an estimator, readings."""

from typing import TYPE_CHECKING

from palpate.core.plugins import names_at_first_use
from palpate.sensing.frame_sources import FileFrames, open_source
from palpate.sensing.sensing_loop import Sensed, sense

if TYPE_CHECKING:
    from palpate.sensing.live_loop import LiveLoop, LiveReading, LiveState
    from palpate.sensing.live_sources import LiveSource, open_live_source
    from palpate.sensing.sensing_loop import Live, live

_LIVE = {
    "Live": "sensing_loop",
    "LiveLoop": "live_loop",
    "LiveReading": "live_loop",
    "LiveSource": "live_sources",
    "LiveState": "live_loop",
    "live": "sensing_loop",
    "open_live_source": "live_sources",
}
"""What loads tables and video, which the reading of one image does not need: imported when first used."""

__all__ = [
    "FileFrames", "Live", "LiveLoop", "LiveReading", "LiveSource", "LiveState",
    "Sensed", "live", "open_live_source", "open_source", "sense",
]  # fmt: skip

if not TYPE_CHECKING:  # mypy accepts only the names imported above
    __getattr__, __dir__ = names_at_first_use(__name__, _LIVE, __all__)
