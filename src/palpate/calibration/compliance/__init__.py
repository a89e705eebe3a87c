"""A TacTip calibrated on specimens of known stiffness, and what it then says of another."""

__all__: list[str] = []
