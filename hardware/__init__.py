"""The robot's own side: motor codec, CAN bus, guards, control loop, and a simulated bus to rehearse on.

Needs numpy and python-can, and from `sim` only the observation layout and the actor.
"""
