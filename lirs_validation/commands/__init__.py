"""The commands of `lirs-wct`, one theme a file; `lirs_validation.cli` puts them together."""
