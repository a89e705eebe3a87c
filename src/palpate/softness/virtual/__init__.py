"""A virtual rendering bench: display, arm and finger, as their physics has them."""
