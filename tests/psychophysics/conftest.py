from tests.small_figures import figures_blank

__all__ = ["figures_blank"]
