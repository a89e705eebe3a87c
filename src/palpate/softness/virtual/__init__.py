"""A virtual rendering bench: display, arm and finger, as their physics has them."""

from palpate.softness.virtual.rendering_bench import BenchParts, BenchTruth, RenderingBench

__all__ = ["BenchParts", "BenchTruth", "RenderingBench"]
