"""Settings of all tests."""

from hypothesis import settings

# The first call of a compiled function takes seconds; and a run of the tests must mean the same for everyone.
settings.register_profile("project", deadline=None, derandomize=True)
settings.load_profile("project")
