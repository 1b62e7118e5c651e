"""The paper, reproduced: its tables and figures from runs in a simulated rig, and what it leaves out.

Import from its modules; some of them load a plotting library, which those who need only the others need not have.
"""
