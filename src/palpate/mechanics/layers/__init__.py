"""Any indenter on a stack of bonded linear layers, by Fourier transforms: contact, friction, stress.

Each module is one step of it and is asked for by its path: `stack` and `indenters` say what touches what,
`contact_solver` and `stack_friction` solve it, `layer_stress` and `stack_field` give the stress below.
"""

__all__: list[str] = []
