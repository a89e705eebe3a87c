"""Optical flow of touch images: Horn and Schunck's, itself and from coarse to fine, and others'.

`flow_sequence` has all of them by name; each is asked for by its module.
"""

__all__: list[str] = []
