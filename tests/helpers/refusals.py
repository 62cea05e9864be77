"""Errors as dirl tells them."""

import pytest


def refused(told, call, *arguments, **options):
    """Call what must fail: the one line of an error of dirl's own, in which the pattern ``told`` is found."""
    with pytest.raises(ValueError, match=told) as caught:
        call(*arguments, **options)
    assert type(caught.value).__module__.startswith("dirl."), repr(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)
