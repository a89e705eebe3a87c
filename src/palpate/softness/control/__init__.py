"""Control of a rendering bench: references, servos, passivity, and the loop that ticks."""
