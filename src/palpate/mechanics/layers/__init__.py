"""Any indenter on a stack of bonded linear layers, by Fourier transforms: contact, friction, and stress."""

__all__: list[str] = []
