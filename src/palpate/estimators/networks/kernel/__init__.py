"""Kernel ridge regression on features of an image that inner folds choose; needs no torch."""

from palpate.estimators.networks.kernel.kernel_ridge import KernelRidge

__all__ = ["KernelRidge"]
