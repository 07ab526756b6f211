"""A soak of datasets: with kills, pauses, full disks and wrong clocks in between, they end as undisturbed ones."""
