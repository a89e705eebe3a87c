"""Optical flow of touch images: Horn and Schunck, coarse to fine, and OpenCV's methods."""

__all__: list[str] = []
