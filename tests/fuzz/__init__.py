"""The project's fuzzer: damaged files for everything that reads one, each case in a process of its own."""
