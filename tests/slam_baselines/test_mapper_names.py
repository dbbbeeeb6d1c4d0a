"""Names of mappers in sentences and folders."""

import pytest

from slam_baselines.mapper import file_name, short_name


@pytest.mark.parametrize(
    ("mapper", "short", "file"),
    [
        ("hector", "hector", "hector"),
        ("evalio:dlio", "evalio:dlio", "evalio-dlio"),
        ("my_icp:Sweep", "Sweep", "Sweep"),
        ("a.b:c.d", "c.d", "c.d"),
    ],
)
def test_a_mapper_of_your_own_goes_by_its_class(mapper: str, short: str, file: str) -> None:
    assert (short_name(mapper), file_name(mapper)) == (short, file)
