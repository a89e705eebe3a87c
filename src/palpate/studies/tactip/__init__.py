"""The compliance report on the virtual TacTip: its experiments made again, and its controls."""

from palpate.studies.tactip.experiment import Experiment, press_all
from palpate.studies.tactip.reproduce import Study, reproduce_tactip

__all__ = ["Experiment", "Study", "press_all", "reproduce_tactip"]
