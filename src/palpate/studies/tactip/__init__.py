"""The compliance report on the virtual TacTip: its experiments made again, and its controls."""
