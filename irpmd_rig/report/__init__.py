"""Figures and pages: what a person looks at, of a run and of whatever else has results.

Import from its modules; some of them load a plotting library, which those who need only the others need not have.
"""
