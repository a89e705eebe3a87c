"""The NUSense thesis's experiments on the virtual pad, each beside what is printed, and controls."""

from palpate_reproductions.nusense.nusense_reproduction import reproduce_nusense
from palpate_reproductions.nusense.nusense_setup import scale_named

__all__ = ["reproduce_nusense", "scale_named"]
