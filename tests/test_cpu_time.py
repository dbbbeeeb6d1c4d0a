from tests.cpu_time import LIMITS, summary


def test_excesses_are_named_with_the_longest_first() -> None:
    limits = {"fast_test_cpu_seconds": 1.0, "fast_tests_cpu_seconds": 4}
    assert summary({"a": 1.0, "b": 1.01, "c": 2.5}, limits) == [
        "3 fast tests took 5 CPU seconds, 1 over the limit; 2 took more than 1",
        "    2.50 c",
        "    1.01 b",
    ]
    assert summary({"a": 1.0}, limits) == ["1 fast tests took 1 CPU seconds; 0 took more than 1"]
    assert LIMITS.keys() > limits.keys()
