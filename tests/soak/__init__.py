"""A soak of datasets: a long run with kills, pauses, full disks and wrong clocks in between ends as an undisturbed one."""
