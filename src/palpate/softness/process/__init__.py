"""Rendering in a process of its own: bench file, loop owner, and client."""

from palpate.softness.process.bench_file import BenchFile, read_bench
from palpate.softness.process.rendering_session import RenderingSession, RenderingStatus

__all__ = ["BenchFile", "RenderingSession", "RenderingStatus", "read_bench"]
