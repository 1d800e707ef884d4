"""A failed assertion of the helpers shows its values, as one of the tests does."""

import pytest

pytest.register_assert_rewrite("helpers")
