"""Press a ball into a clear skin and look at it edge-on between crossed polarisers.

Run it to draw the frames. Imported, it computes them and draws nothing.
"""

import numpy as np

from palpate.core import Pose
from palpate.sensors import demo, press, render

sensor = demo()
rng = np.random.default_rng(0)
depths_mm = (0.1, 0.3, 0.6, 0.9, 1.2)
contacts = [press(sensor, Pose(x_m=0.0, y_m=0.0, depth_m=d * 1e-3)) for d in depths_mm]
frames = [render(contact, sensor, rng) for contact in contacts]


def draw(path: str = "press_and_render.png") -> None:
    """Write the frames and the force against depth to an image file."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(12, 5.6), layout="constrained")
    x_mm, z_mm = sensor.x_m * 1e3, sensor.z_m * 1e3
    for axis, depth, contact, frame in zip(axes.flat, depths_mm, contacts, frames, strict=False):
        axis.imshow(frame.image, extent=(x_mm[0], x_mm[-1], z_mm[-1], z_mm[0]))
        axis.set(title=f"{depth} mm, {contact.force_n:.2f} N", xlabel="x / mm", ylabel="z / mm")
    axes.flat[-1].plot(depths_mm, [contact.force_n for contact in contacts], "o-")
    axes.flat[-1].set(title="Hertz: F rises as depth to 3/2", xlabel="depth / mm", ylabel="force / N")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    draw()
