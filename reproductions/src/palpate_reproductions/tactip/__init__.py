"""The compliance report on the virtual TacTip: reproduced, its controls, and its equation (3) itself."""

from palpate_reproductions.tactip.tactip_reproduction import TRIALS, reproduce_tactip

__all__ = ["TRIALS", "reproduce_tactip"]
