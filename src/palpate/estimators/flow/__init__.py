"""Optical flow of touch images: Horn and Schunck's, itself and from coarse to fine, and others'."""
