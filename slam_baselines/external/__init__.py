"""Adapters of other people's SLAM systems; each needs its package, which an extra installs."""
