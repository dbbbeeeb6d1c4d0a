"""Gymnasium environments of LIRS-WCT; importing this package registers them."""

from gymnasium.envs.registration import register

register(
    id="LIRS/Mapping-v0",
    entry_point="lirs_envs.mapping_env:MappingEnv",
    max_episode_steps=3000,
    kwargs={"world": "simple", "robot": "husky"},
)
