"""The error of everything that is not a scene."""


class SceneError(ValueError):
    """An invalid scene, or what should become one; the message says what is wrong, where, and what to do."""
