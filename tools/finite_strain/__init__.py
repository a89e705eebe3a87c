"""Finite-strain, axisymmetric press of a rigid sphere into a bonded disc; makes the shipped press tables.

Lengths are in sphere radii, stresses in Young's moduli, forces in E R^2; z points into the layer. Only the
table generator uses this; it needs scikit-fem, which palpate itself does not.
"""
