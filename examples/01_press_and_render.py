"""Press a ball into the virtual photoelastic palm and look at it edge-on and through the mirror.

Run it to draw the frames. Imported, it computes them and draws nothing.
"""

import numpy as np

from palpate.core import Pose
from palpate.sensors import palm

sensor = palm.small()
rng = np.random.default_rng(0)
presses_mm = ((1.0, 0.0, 0.0), (3.0, 0.0, 0.0), (5.0, 0.0, 0.0), (3.0, 8.0, -6.0))
contacts = [palm.press(sensor, Pose(x * 1e-3, y * 1e-3, depth * 1e-3)) for depth, x, y in presses_mm]
frames = [palm.render(contact, sensor, rng) for contact in contacts]


def draw(path: str = "press_and_render.png") -> None:
    """Write the frames to an image file."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11, 6.6), layout="constrained")
    for axis, (depth, x, y), contact, frame in zip(axes.flat, presses_mm, contacts, frames, strict=True):
        axis.imshow(frame.image)
        axis.set_title(f"{depth:g} mm deep at ({x:g}, {y:g}) mm: {contact.force_n:.1f} N")
        axis.axis("off")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw()
