"""The order of the loop search."""

from __future__ import annotations

from slam_baselines.cartographer.loop_closure.candidates import CandidateQueue
from slam_baselines.cartographer.loop_closure_config import CandidateConfig


def test_the_queue_takes_new_nodes_first_and_enough_is_enough():
    queue = CandidateQueue(CandidateConfig(found_per_pair=2, tries_per_pair=3, max_num_candidates=5))
    queue.add_candidate(1, 0, 7, new_node=False)
    queue.add_candidate(20, 5, 7, new_node=True)
    queue.add_candidate(21, 5, 7, new_node=True)
    assert [
        queue.next_candidate(),
        queue.next_candidate(),
        queue.next_candidate(),
        queue.next_candidate(),
    ] == [(21, 7), (20, 7), (1, 7), None]
    queue.record_result(20, 7, found=True)
    queue.record_result(21, 7, found=True)
    queue.add_candidate(22, 5, 7, new_node=True)
    assert queue.next_candidate() is None
    for i in range(8):
        queue.add_candidate(i, 9, 3, new_node=False)
    assert (len(queue), queue.dropped) == (5, 3)
