"""What is raised beside TypeError and ValueError, which are for misuse."""


class KernelError(Exception):
    """What may be caught as one: a call was right, and cannot be done here."""


class BackendUnavailable(KernelError, ImportError):
    """A backend that is known but cannot be loaded here; the message carries the cause and the remedy."""


class OperationRefused(KernelError, NotImplementedError):
    """An operation, dtype or device that the backend refuses; the message carries its reason."""
