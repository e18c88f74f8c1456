"""What all tests share."""

from hypothesis import settings

settings.register_profile("unhurried", deadline=None)  # no timed asserts: the machine may be busy
settings.load_profile("unhurried")
