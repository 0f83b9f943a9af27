# What .ci/run runs, one target at a time, in the active virtual environment.

PYTHON ?= python
CSRC = $(shell find csrc -name '*.[ch]pp' -o -name '*.h' -o -name '*.inl')
CLANGXX ?= clang++
FUZZ_SECONDS ?= 60
JOBS ?= $(shell nproc 2>/dev/null || echo 2)
comma = ,

.PHONY: build test lint types sanitize tsan fuzz bench bench-quick bench-report bench-check

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
SETS = $(shell sed -n "s/ *|.*//p" csrc/isa/sets.txt | grep -v "\#")
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
	$(in_bench) -m bench.backprojection --readme ../../README.md

bench-quick:
	$(in_bench) -m bench.backprojection --quick
	$(in_bench) -m pytest bench -n 0 -p no:cacheprovider -q -k complex128 --benchmark-columns=median,iqr,rounds

# fails where an engine breaks its tol
bench-report:
	$(in_bench) -m bench.report --quick --docs . --json error-vs-time.json

# ratios of speeds against those stored in bench/ratios.json
bench-check:
	$(in_bench) -m bench.check
