"""Mutants: the code with one line changed, each of which a test must notice."""
