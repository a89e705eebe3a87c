from tests.small_figures import figures_blank, figures_small

__all__ = ["figures_blank", "figures_small"]
