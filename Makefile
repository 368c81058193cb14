# SPDX-License-Identifier: GPL-3.0-or-later
# `make` lists the targets. Nothing has to be installed before: see .ci/environment.py.

PYTHON ?= python3
NAME := timescale_normals
VERSION := $(shell sed -n 's/^version = "\(.*\)"/\1/p' blender_manifest.toml)
OS := $(patsubst Darwin,macos,$(patsubst Linux,linux,$(shell uname -s)))
ARCH := $(patsubst aarch64,arm64,$(patsubst x86_64,x64,$(shell uname -m)))
PLATFORM ?= $(OS)-$(ARCH)
# The zip that runs here; PLATFORM only says what else `make zip` builds.
ZIP := dist/$(NAME)-$(VERSION)-$(OS)_$(ARCH).zip
SHIPPED := blender_manifest.toml __init__.py LICENSE README.md \
	$(shell find addon core -name __pycache__ -prune -o -print)

CORE := .venv/core/bin/python
# -P and an empty pythonpath keep the checkout's `core` out of reach.
BLENDER_TESTS := -P -m pytest -o pythonpath= tests/blender

.DEFAULT_GOAL := help
.PHONY: help environment core-environment demo reproduce test test-core test-blender lint zip clean test-app docs

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 24

demo: environment $(ZIP) ## normals, comparison and pictures into out/; INPUT=file for your own
	@$$(ls -d .venv/blender-*/ | sort -V | tail -1)bin/python -P docs/demo.py \
		--zip $(ZIP) $(if $(INPUT),"$(INPUT)")

reproduce: environment $(ZIP) ## the paper's experiment into OUT, out/reproduce, and docs/results.md; SEEDS=3
	@$$(ls -d .venv/blender-*/ | sort -V | tail -1)bin/python docs/reproduce.py \
		--zip $(ZIP) -o "$(or $(OUT),out/reproduce)" --seeds $(or $(SEEDS),3)

test: test-core test-blender ## all tests

test-core: core-environment ## the numbers, without Blender
	$(CORE) -m pytest

test-blender: environment $(ZIP) ## the built and installed zip in every Blender that is there
	@failed=; for venv in .venv/blender-*/; do \
		TIMESCALE_ZIP=$(abspath $(ZIP)) $$venv/bin/python $(BLENDER_TESTS) \
			|| failed="$$failed $$venv"; \
	done; test -z "$$failed" || { echo "failed in:$$failed"; exit 1; }

test-app: environment $(ZIP) ## the real program in a window; CHROOT=folder of tests/app/chroot.sh
	TIMESCALE_ZIP=$(abspath $(ZIP)) TIMESCALE_CHROOT=$(or $(CHROOT),/) \
		$(CORE) -P -m pytest -o pythonpath= tests/app

docs: environment $(ZIP) ## the pictures of docs/guide.md, in the real program; CHROOT as above
	TIMESCALE_CHROOT=$(or $(CHROOT),/) $(CORE) docs/guide.py --zip $(ZIP)

.PHONY: bench
bench: ## time, memory and error next to peers, into docs/performance.md; OPTIONS=--large for 10M points
	@PYTHONPATH=.ci $(PYTHON) tests/benchmarks/install.py
	@PYTHONPATH=. .venv/bench/bin/python tests/benchmarks/speed.py --write $(OPTIONS)

.PHONY: bench-orientation
bench-orientation: ## sides, time and memory next to peers, into docs/accuracy.md; OPTIONS="--meshes FOLDER"
	@PYTHONPATH=.ci $(PYTHON) tests/benchmarks/install.py
	@PYTHONPATH=. .venv/bench/bin/python tests/benchmarks/orientation.py --write $(OPTIONS)

.PHONY: bench-meshes
bench-meshes: ## normals of meshes made worse, beside Blender's and peers', into docs/accuracy.md
	@PYTHONPATH=.ci $(PYTHON) tests/benchmarks/install.py
	@PYTHONPATH=. .venv/bench/bin/python tests/benchmarks/meshes.py --write $(OPTIONS)

.PHONY: bench-door
bench-door: environment $(ZIP) ## time in and out of Blender's memory, into docs/performance.md
	@for venv in .venv/blender-*/; do \
		$$venv/bin/python tests/benchmarks/door.py --zip $(ZIP) --write; done

.PHONY: bench-accuracy train
bench-accuracy: ## errors under noise and at creases next to peers, into docs/accuracy.md; OPTIONS=--no-peers
	@PYTHONPATH=.ci $(PYTHON) tests/benchmarks/install.py
	@PYTHONPATH=. .venv/bench/bin/python tests/benchmarks/accuracy.py --write $(OPTIONS)

train: core-environment ## the weights of core/auto/blend.npz anew, from shapes made on the spot
	$(CORE) tests/benchmarks/train.py $(OPTIONS)

# Types are checked under the name of the package, whatever the checkout is called.
lint: core-environment ## ruff and mypy
	$(CORE) -m ruff check .
	$(CORE) -m ruff format --check .
	@mkdir -p build/types && ln -sfn ../.. build/types/$(NAME)
	cd build/types && $(abspath $(CORE)) -m mypy --config-file ../../pyproject.toml \
		-p $(NAME).core -p $(NAME).addon -m $(NAME)

zip: environment $(ZIP) ## the extension, built and validated, in dist/; PLATFORM=all for every platform
ifneq ($(PLATFORM),$(OS)-$(ARCH))
	@$(CORE) .ci/package.py $(PLATFORM)
endif

$(ZIP): $(SHIPPED) .ci/package.py | environment
	@$(CORE) .ci/package.py $(OS)-$(ARCH)

environment:
	@$(PYTHON) .ci/environment.py

core-environment:
	@$(PYTHON) .ci/environment.py core

clean: ## remove what was built; the environments and wheels stay
	rm -rf build dist
