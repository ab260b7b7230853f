"""Monte Carlo campaigns: plan, worker, summary, command."""
