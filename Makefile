# What .ci/run runs, one target at a time, in the active virtual environment.

PYTHON ?= python
CSRC = $(shell find csrc -name '*.[ch]pp' -o -name '*.h' -o -name '*.inl')
SANITIZED = build/sanitize/test_cpu

.PHONY: build test lint types sanitize bench

build:
	$(PYTHON) -m pip install '.[dev]'

test:
	pytest

lint:
	ruff check
	ruff format --check
	clang-format --dry-run -Werror $(CSRC)

types:
	mypy --strict pysas

sanitize:
	mkdir -p $(dir $(SANITIZED))
	$(CXX) -std=c++17 -O1 -g -Wall -Wextra -Wpedantic -Wconversion -Werror -fsanitize=address,undefined \
		-fno-sanitize-recover=all -fno-omit-frame-pointer -Icsrc csrc/tests/test_cpu.cpp csrc/core/*.cpp -o $(SANITIZED)
	$(SANITIZED)

# from a folder that holds bench/ and no pysas/, so that the installed package is measured and not the sources beside it
bench:
	mkdir -p build/bench && ln -sfn ../../bench build/bench/bench
	cd build/bench && $(PYTHON) -m bench.backprojection --quick
