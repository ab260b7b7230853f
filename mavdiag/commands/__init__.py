"""The commands of `mavdiag`, one file each: parse, call, print. `mavdiag.cli` puts them together."""
