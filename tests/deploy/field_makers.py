"""The site on the loopback interface that `pose-eval field` measures, for tests."""

from fleetpose.evaluation.system.field.site import Field, listening_port, no_password, opened

__all__ = ["Field", "listening_port", "no_password", "opened"]
