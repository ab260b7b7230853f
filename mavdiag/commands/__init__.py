"""The commands of `mavdiag`, one file each; `mavdiag.cli` puts them together."""
