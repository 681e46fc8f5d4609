"""The main job on devices: a line, a surface or both, followed by an arm behind its controller's interface.

Nothing here, and nothing that is imported from here, knows the simulated world.
"""
