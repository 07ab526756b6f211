# make demo | make test | make lint | make validate: each first makes what it needs, an environment in .venv.
# `make demo` installs the package; the others add the libraries and tools of the extra `test`.
# PYTHON=/path/to/python chooses the interpreter (3.11 or newer).

SHELL := /bin/sh
VENV := .venv
BIN := $(VENV)/bin
PYTHONS := $(if $(PYTHON),$(PYTHON),python3.13 python3.12 python3.11 python3)
IS_NEW := import sys; sys.exit(sys.version_info < (3, 11))
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
# What a lock file lists, by the hashes of its files, and nothing that it does not list.
LOCKED := $(PIP) install --require-hashes --no-deps --no-build-isolation --use-pep517 -r
APT := env DEBIAN_FRONTEND=noninteractive apt-get -q -y -o Acquire::Retries=0 -o Acquire::http::Timeout=20

LEARN_TESTS := tests/dasim/dataset/test_reading.py tests/dasim/differentiable tests/examples/test_learned_ring.py \
    tests/examples/test_read_shards.py tests/recon/depth/test_learned.py tests/validation/training

FUZZ_CASES := 2000
FUZZ_SEED := 0

.PHONY: help demo test test-slow test-lens test-learn fuzz lint docs validate audit locks environment test-environment

help:
	@echo "make demo   the whole chain on a bundled scene; report in out/demo/report.html"
	@echo "make test   the tests, without the slow ones, on up to four processor cores"
	@echo "make test-slow   the slow tests, on as many"
	@echo "make test-lens   the tests of lens prescriptions, with Optiland"
	@echo "make test-learn   the tests of training, learned depth and optics with gradients, with PyTorch (3 GB)"
	@echo "make fuzz   2,000 damaged files (FUZZ_CASES), each of which must end well; FUZZ_SEED draws others"
	@echo "make lint   style, formatting, import contracts, types"
	@echo "make docs   the documentation, its reference made from the code; open out/docs/index.html"
	@echo "make audit  known vulnerabilities of the packages, by pip-audit, where the network is there"
	@echo "make validate   the quick claims against their limits; report in out/validate/report.html"

demo: environment
	$(BIN)/dasim demo --out out/demo

test: test-environment
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile

test-slow: test-environment
	$(BIN)/python -m pytest -m slow -n auto --maxprocesses 4 --dist loadfile

test-lens: test-environment $(VENV)/.installed-lens
	$(BIN)/python -m pytest tests/dasim/camera/test_prescription.py

test-learn: test-environment $(VENV)/.installed-learn
	$(BIN)/python -m pytest -m '' $(LEARN_TESTS)

fuzz: test-environment
	$(BIN)/python -m tests.fuzz --cases $(FUZZ_CASES) --seed $(FUZZ_SEED)

lint: test-environment
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo
	$(BIN)/mypy

docs: environment $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

validate: test-environment
	$(BIN)/dasim validate --quick --out out/validate

# Needs a network; what cannot be looked up is counted and is no failure.
audit: environment
	@test -x $(VENV)/audit/bin/python || $(BIN)/python -m venv $(VENV)/audit
	@if $(VENV)/audit/bin/python -m pip --disable-pip-version-check --quiet install --require-hashes -r .ci/locks/audit.txt; \
	then $(BIN)/python .ci/audit.py $(VENV)/audit/bin/python .ci/locks/build.txt .ci/locks/test.txt .ci/locks/docs.txt .ci/locks/lens.txt; \
	else echo "not audited: pip-audit cannot be installed"; fi

# The lock files anew after a change of constraints.txt or of the dependencies; needs uv.
UV := uv pip compile --quiet --generate-hashes --universal --python-version 3.11.7 --no-header --no-annotate
locks:
	printf 'hatchling>=1.24\neditables\nsetuptools\nsetuptools-scm<9\nwheel\n' | $(UV) -c constraints.txt - -o .ci/locks/build.txt
	$(UV) -c constraints.txt pyproject.toml -o .ci/locks/dasim.txt
	for extra in test docs lens; do $(UV) -c constraints.txt pyproject.toml --extra $$extra -o .ci/locks/$$extra.txt || exit 1; done
	echo 'pip-audit>=2.9' | $(UV) - -o .ci/locks/audit.txt

environment: $(VENV)/.llvm

test-environment: environment $(VENV)/.installed-test

# The environment anew where a dependency changed.
$(VENV)/.installed: pyproject.toml .ci/locks/build.txt .ci/locks/dasim.txt
	@if $(BIN)/python -c '$(IS_NEW)' 2>/dev/null && $(BIN)/python -m pip --version >/dev/null 2>&1; then exit 0; fi; \
	new=; \
	for python in $(PYTHONS); do \
	    "$$python" -c '$(IS_NEW)' >/dev/null 2>&1 || continue; \
	    new="$$python"; \
	    "$$python" -c 'import ensurepip, venv' >/dev/null 2>&1 || continue; \
	    echo "Making $(VENV) with $$("$$python" --version)"; \
	    exec "$$python" -m venv --clear $(VENV); \
	done; \
	if [ -n "$$new" ]; then \
	    echo "$$new has no venv or ensurepip; on Debian and Ubuntu 'apt-get install python3-venv' brings both" >&2; \
	else \
	    echo "Python 3.11 or newer is needed, none was found as: $(PYTHONS)" >&2; \
	fi; \
	exit 1
	@echo "Installing the packages of .ci/locks/dasim.txt (some minutes the first time)"
	@$(LOCKED) .ci/locks/build.txt
	@$(LOCKED) .ci/locks/dasim.txt
	@$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.installed-test: $(VENV)/.installed .ci/locks/test.txt
	@echo "Installing what the tests need besides (some minutes the first time)"
	@$(LOCKED) .ci/locks/test.txt
	@touch $@

$(VENV)/.installed-docs: $(VENV)/.installed .ci/locks/docs.txt
	@echo "Installing MkDocs for the documentation"
	@$(LOCKED) .ci/locks/docs.txt
	@touch $@

$(VENV)/.installed-lens: $(VENV)/.installed-test .ci/locks/lens.txt
	@echo "Installing Optiland for lens prescriptions (some minutes the first time)"
	@$(LOCKED) .ci/locks/lens.txt
	@touch $@

$(VENV)/.installed-learn: $(VENV)/.installed-test
	@echo "Installing PyTorch (3 GB on Linux, where its wheel brings CUDA)"
	@$(PIP) install -c constraints.txt -e '.[test,learn]'
	@touch $@

# Rendering is about four times faster with LLVM 17 or newer. Without it, dasim falls back to a slower variant with
# approximate diffraction, so nothing here ends the run.
$(VENV)/.llvm: $(VENV)/.installed
	@if $(BIN)/python -m dasim.render.backend; then :; \
	elif [ "$$(uname -s)" = Linux ] && [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then \
	    echo "Installing LLVM for faster rendering: apt-get install libllvm19"; \
	    if $(APT) install libllvm19 >$(VENV)/apt.log 2>&1 \
	        || { $(APT) update >>$(VENV)/apt.log 2>&1 && $(APT) install libllvm19 >>$(VENV)/apt.log 2>&1; }; \
	    then $(BIN)/python -m dasim.render.backend || :; \
	    else echo "That failed (see $(VENV)/apt.log); going on with the slower variant"; fi; \
	else \
	    echo "Going on with the slower variant"; \
	fi
	@touch $@
