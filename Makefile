# What .ci/run runs, one target at a time, in the active virtual environment.

PYTHON ?= python
CSRC = $(shell find csrc -name '*.[ch]pp' -o -name '*.h' -o -name '*.inl')
CLANGXX ?= clang++
FUZZ_SECONDS ?= 60
JOBS ?= $(shell nproc 2>/dev/null || echo 2)
comma = ,

.PHONY: build test lint types sanitize tsan qemu fuzz bench bench-quick bench-report bench-check docs docs-links wheel stranger

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

# the core and its kernels for the sets $(4), compiled with $(1) into build/$(2), and the program of sources $(3)*, linked with $(5)
define core_program
	mkdir -p build/$(2)
	{ for set in $(4); do echo csrc/isa/$$set.cpp; done; ls csrc/core/*.cpp csrc/planning/*.cpp csrc/bind/c_api.cpp csrc/tests/$(3)*.cpp; } | xargs -P $(JOBS) -I{} sh -c ' \
		name=$$(basename {} .cpp); exec $(1) $(STRICT) "-DPYSAS_SETS=$(foreach set,$(filter-out baseline,$(4)),PYSAS_SET($(set)))" \
		$$(sed -n "s/^$$name *|[^|]*|\([^|]*\)|.*/\1/p" csrc/isa/sets.txt) -c {} -o build/$(2)/$$name.o'
	$(1) build/$(2)/*.o -pthread $(5) -o build/$(2)/$(3)
endef
# what csrc/isa/sets.txt has for the machine that the compiler $(1) compiles for
machine_of = $(patsubst aarch64%,arm64,$(patsubst arm64%,arm64,$(patsubst i%86%,x86,$(patsubst x86_64%,x86,$(shell $(1) -dumpmachine 2>/dev/null)))))
sets_of = $(shell awk -F"[ |]+" '$$2 == "$(call machine_of,$(1))" { print $$1 }' csrc/isa/sets.txt)
SETS = $(call sets_of,$(CXX))
STRICT = -std=c++17 -g -ffp-contract=off -fno-omit-frame-pointer -Wall -Wextra -Werror -Icsrc -Icsrc/include

sanitize:
	mkdir -p build/sanitize
	$(CXX) $(STRICT) -O1 -Wpedantic -Wconversion -fsanitize=address,undefined -fno-sanitize-recover=all \
		csrc/tests/test_cpu.cpp csrc/core/cpu.cpp -o build/sanitize/test_cpu
	build/sanitize/test_cpu
	$(call core_program,$(CXX) -O0 -fsanitize=address$(comma)undefined -fno-sanitize-recover=all,sanitize,test_core,baseline $(SETS))
	build/sanitize/test_core

tsan:
	$(call core_program,$(CLANGXX) -O1 -Wno-unknown-warning-option -fsanitize=thread,tsan,test_core,baseline)
	build/tsan/test_core

# The core for 64-bit ARM, compiled across and run by qemu, with UBSan; then, with kernels as they are shipped in place of those,
# scenes through the C ABI against the oracle, whose answers are made before; instructions a term beside AVX2's, where pip has
# left those kernels here. CROSS= and CROSSXX=g++: the same on this machine.
CROSSXX ?= aarch64-linux-gnu-g++
CROSS ?= qemu-aarch64 -L /usr/aarch64-linux-gnu
UBSAN = -O1 -fsanitize=undefined -fno-sanitize-recover=all
qemu:
	@missing=; command -v $(CROSSXX) >/dev/null || missing=" g++-aarch64-linux-gnu"; \
	command -v $(firstword $(CROSS) true) >/dev/null || missing="$$missing qemu-user"; \
	[ -z "$$missing" ] || { echo "make qemu needs packages that are not installed:$$missing"; exit 1; }
	rm -rf build/qemu
	$(call core_program,$(CROSSXX) $(UBSAN),qemu,test_core,baseline $(call sets_of,$(CROSSXX)))
	$(CROSS) build/qemu/test_core
	rm build/qemu/test_core*
	printf '%s\n' baseline $(call sets_of,$(CROSSXX)) | xargs -P $(JOBS) -I{} sh -c 'exec $(CROSSXX) $(STRICT) -O3 \
		$$(sed -n "s/^{} *|[^|]*|\([^|]*\)|.*/\1/p" csrc/isa/sets.txt) -c csrc/isa/{}.cpp -o build/qemu/{}.o'
	$(CROSSXX) $(STRICT) $(UBSAN) csrc/tests/test_scenes.cpp build/qemu/*.o -pthread -o build/qemu/test_scenes
	$(CROSSXX) $(STRICT) $(UBSAN) csrc/tests/test_cpu.cpp csrc/core/cpu.cpp -o build/qemu/test_cpu
	$(CROSS) build/qemu/test_cpu
	$(PYTHON) tests/oracle_scenes.py build/qemu/scenes.bin
	$(CROSS) build/qemu/test_scenes build/qemu/scenes.bin
	for avx2 in build/temp*/csrc/isa/avx2.o; do \
		! [ -f $$avx2 -a -f build/qemu/neon.o ] || $(PYTHON) -m bench.instructions $$avx2 build/qemu/neon.o || exit 1; done

# without traces of comparisons: they made ten seconds of a third of one in loops over filters' taps, and find nothing among
# doubles
fuzz:
	$(call core_program,$(CLANGXX) -O1 -Wno-unknown-warning-option -fsanitize=fuzzer-no-link$(comma)address$(comma)undefined -fno-sanitize-coverage=trace-cmp -fno-sanitize-recover=all,fuzz,fuzz_c_api,baseline avx512,-fsanitize=fuzzer)
	mkdir -p build/fuzz/corpus
	build/fuzz/fuzz_c_api -max_total_time=$(FUZZ_SECONDS) -max_len=8192 -timeout=60 -rss_limit_mb=4096 -print_final_stats=1 -artifact_prefix=build/fuzz/ build/fuzz/corpus \
		> build/fuzz/log 2>&1 || { tail -40 build/fuzz/log; exit 1; }
	tail -8 build/fuzz/log

# from a folder that holds bench/ and no pysas/, so that the installed package is measured and not the sources beside it
in_bench = mkdir -p build/bench && ln -sfn ../../bench build/bench/bench && cd build/bench && $(PYTHON)

bench:
	$(in_bench) -m bench.figures --write ../../docs/figures.md

bench-quick:
	$(in_bench) -m bench.backprojection --quick
	$(in_bench) -m pytest bench -n 0 -p no:cacheprovider -q -k complex128 --benchmark-columns=median,iqr,rounds

# fails where an engine breaks its tol
bench-report:
	$(in_bench) -m bench.report --quick --docs . --json error-vs-time.json

# ratios of speeds against those stored in bench/ratios.json
bench-check:
	$(in_bench) -m bench.check

# the site, from docs/, the docstrings and examples/gallery, all of which is run; a warning, a link within the site that leads
# nowhere, or a public name that the reference lacks ends it. All of it is made anew.
docs:
	rm -rf build/docs build/doctrees docs/reference/names docs/gallery
	sphinx-build -q -W --keep-going -n -j auto -d build/doctrees -b html docs build/docs
	$(PYTHON) docs/links.py build/docs

# links out of the site, which need the internet
docs-links:
	PYSAS_GALLERY=False sphinx-build -q -n -d build/doctrees-links -b linkcheck docs build/docs-links

# for Linux, by way of a source distribution, which holds all that a build needs then;
# `make wheel BUILD="--wheel -C--build-option=--skip-build"` packs what pip has just built in this folder
BUILD ?=
wheel:
	rm -rf build/wheel
	$(PYTHON) -m build $(BUILD) -o build/wheel .
	$(PYTHON) -m auditwheel repair --strip -w build/wheel/repaired build/wheel/*.whl
	$(PYTHON) .ci/check_wheel.py build/wheel/repaired/*.whl

# seconds from nothing to an image of an own file, with the wheel that is there; PIP_NO_CACHE_DIR=1 downloads all of it
stranger:
	$(PYTHON) .ci/stranger.py build/wheel/repaired/*.whl
