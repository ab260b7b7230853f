"""From streams to rows on a uniform grid: alignment, gate, rates, sliding windows. Knows no link and no log."""
