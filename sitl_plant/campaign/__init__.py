"""Monte Carlo campaigns: plan, worker, runner, summary, tables."""
