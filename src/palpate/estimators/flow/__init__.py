"""Optical flow of touch images: Horn and Schunck, and OpenCV's dense inverse search."""

__all__: list[str] = []
