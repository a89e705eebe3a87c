"""Any indenter on a stack of bonded linear layers, by Fourier transforms: contact, friction, stress."""

__all__: list[str] = []
