"""HTML reports from stored records alone, without solvers, scenes or other rooms."""
