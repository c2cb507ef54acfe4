# Everything a newcomer types: `make demo` and `make test`. Each sets up what it needs.

# The distribution's own Python comes first: it is optimised by profiles of its runs, which pyenv
# leaves out unless it is asked, and tests take a fifth less CPU time.
PYTHON ?= $(shell /usr/bin/python3.11 -c 'import ensurepip, venv' 2>/dev/null && echo /usr/bin/)python3.11
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.gsgen-ready

# Some containers forbid Python to write bytecode: each process would compile the project anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo test test-all test-nightly coverage tools check types style drivers bench exactness web npm ort fuzz fuzz-formats untrusted fuzz-tiles fuzz-sort pictures gallery hero tutorial docs wheel release owner mutants neighbours clean

setup: $(READY)

# torch comes by exact version: asked for as a range, its newest build would be fetched, with
# gigabytes of CUDA packages. Then the extras are asked for, lest a package is not pinned. Of twelve
# thousand modules two thousand are used: Python compiles them when they are imported.
INSTALL := $(BIN)/python scripts/install.py

$(READY): pyproject.toml constraints.txt
	@echo "setting up $(VENV): a minute or two, once"
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is not installed: name another with make PYTHON=…"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) --no-deps -r constraints.txt
	$(INSTALL) -e '.[all]' --group dev
	@$(BIN)/python -c 'import hypothesis, onnxruntime, onnxscript, pytest, scipy.spatial, torch.export, wgpu'
	@touch $@

# The software Vulkan driver that tests and `gsgen doctor` use where there is no GPU, another one
# that tests compare it with, and what loads tilesets and checks the browser client.
drivers:
	scripts/fetch.sh drivers cesium swiftshader browser

demo: setup
	@scripts/fetch.sh drivers || echo "demo: going on, with pictures only where there is a GPU"
	$(BIN)/python docs/examples/demo.py out/demo

# A file's tests stay in one worker: they share the models that they export. Each worker computes in
# one thread: those of several workers would wait for each other.
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q -n auto --dist loadfile

# The checks, and the tests of every room that take little time.
test: tools check
	$(PYTEST) -m "not slow and not nightly"

# The other tests: more exports, pages, damaged files and long films.
test-all: tools
	$(PYTEST) -m "slow and not nightly"

# Tests that take too long for each change.
test-nightly: tools
	$(PYTEST) -m nightly

# The share of the contract's lines that its own tests run; those of a process that they start count.
coverage: tools
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -q -n auto --dist loadfile -m "not nightly" tests/cli tests/conformance tests/contract
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report --include='contract/*' --fail-under=90

# What tests need besides packages. Drivers are fetched while packages are installed.
tools:
	@$(MAKE) --no-print-directory -j3 drivers setup ort

# ONNX Runtime Web and three.js, which compute generators and draw without WebGPU in a page:
# fetched once, into the user's cache.
ort: setup
	$(BIN)/python -c 'from gsgen.runtime.web.onnxruntime_web import ort_folder; ort_folder(None)'
	$(BIN)/python -c 'from gsgen.runtime.web.three_js import THREE; THREE.located(None)'

check: setup
	@$(MAKE) --no-print-directory -j2 --output-sync types style

# Nobody reads again what is kept of a clean clone's types, and to write it takes seconds.
types: setup
	$(BIN)/mypy $(if $(CI),--cache-dir=/dev/null)

style: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/python scripts/check_house.py

# Throughput, start-up and memory, as ratios against a baseline measured in the same run.
bench: setup
	$(BIN)/python -m pytest tests/bench -o python_files='bench_*.py' -o python_functions='bench_*' -s -q

# All pixels of a million Gaussians beside the float64 oracle, and what is behind the worst: some
# minutes, and ten times as long for SIZE=1280x720.
SIZE ?= 640x360
exactness: setup drivers
	PYTHONPATH=tests $(BIN)/python tests/bench/exactness.py --size $(SIZE)

# Mutants of models and manifests, which must not crash, hang or bloat the validator. A run that
# was stopped goes on where it was; what failed is kept in out/fuzz, with the way to see it again.
COUNT ?= 20000
SEED ?= 0
MINUTES ?= 90
fuzz: setup
	PYTHONPATH=tests $(BIN)/python -m fuzz --count $(COUNT) --seed $(SEED) --minutes $(MINUTES)

# Damaged splat files of every format, which must be read or refused within 256 MiB and 10 s each.
FORMAT_COUNT ?= 5000
fuzz-formats: setup
	PYTHONPATH=tests $(BIN)/python -m fuzz.formats --count $(FORMAT_COUNT) --seed $(SEED)

# What every command makes of files of an attacker, under the bars that the bench states.
untrusted: setup
	$(BIN)/python tests/bench/bench_untrusted_bytes.py

# Damaged tilesets and tiles, which must be reported or refused within 1 GiB and 20 s each.
fuzz-tiles: setup
	PYTHONPATH=tests $(BIN)/python -m fuzz.tilesets --count $(COUNT) --seed $(SEED)

# Sorts of up to four million keys on every software driver: some minutes.
fuzz-sort: setup drivers
	PYTHONPATH=tests $(BIN)/python -m fuzz.sort

# The pictures of the plugins' pages, drawn anew from synthetic checkpoints: a minute or two.
pictures: setup drivers
	$(BIN)/python scripts/write_pictures.py plugins

# The pictures of the gallery, by running all that stands on its page: two minutes or more.
gallery: setup drivers
	$(BIN)/python scripts/write_pictures.py gallery

# The picture that README.md and the home page open with.
hero: setup drivers
	$(BIN)/python scripts/write_pictures.py hero

# What the cells of the tutorial show on its page.
tutorial: setup drivers
	$(BIN)/python scripts/write_pictures.py tutorial

# What the browser takes from Python: frame plans from the renderer, rules from the contract.
web: setup
	PYTHONPATH=tools $(BIN)/python -m web_client.write

# The browser client as a package for npm, with types, into dist/.
npm: setup
	scripts/fetch.sh browser
	PYTHONPATH=tools $(BIN)/python -m web_client.package dist

docs: setup
	$(INSTALL) --group docs
	$(BIN)/python scripts/write_docs.py
	$(BIN)/zensical build --clean
	$(BIN)/python scripts/name_files.py site
	$(BIN)/python scripts/write_live.py site

wheel: setup
	$(BIN)/python -m build --wheel --outdir dist

# Mutants of one module by cosmic-ray, against the tests that are named. The module changes in place:
# after a run that was stopped, restore it with git.
#   make mutants MODULE=contract/gsgen/contract/spec/units.py TESTS=tests/contract/spec/test_units.py
mutants: setup
	@test -n "$(MODULE)" -a -n "$(TESTS)" || { echo "name both: make mutants MODULE=file TESTS=file"; exit 2; }
	$(INSTALL) --group mutants
	mkdir -p out && rm -f out/mutants.sqlite
	printf '[cosmic-ray]\nmodule-path = "$(MODULE)"\ntimeout = 60.0\nexcluded-modules = []\ntest-command = "$(BIN)/python -m pytest -q -x -p no:cacheprovider $(TESTS)"\n[cosmic-ray.distributor]\nname = "local"\n' > out/mutants.toml
	$(BIN)/cosmic-ray init out/mutants.toml out/mutants.sqlite
	nice -n 15 $(BIN)/cosmic-ray exec out/mutants.toml out/mutants.sqlite
	$(BIN)/cr-report --surviving-only --show-diff out/mutants.sqlite

# All of a release but the upload: RELEASING.md explains each step.
release: setup
	@tag=$$($(BIN)/python scripts/release.py tree) || exit 1; \
	rm -rf dist && $(INSTALL) --group release && \
	$(BIN)/python -m build --outdir dist && \
	$(BIN)/python -m twine check --strict dist/* && \
	$(BIN)/python scripts/release.py wheel dist && \
	git tag -a "$$tag" -m "gsgen $$tag" && \
	echo "$$tag is tagged here, and dist/ holds its files. To publish it:" && \
	echo "  git push origin $$tag && $(BIN)/python -m twine upload dist/*"

# Exchange splats and frames with gsplat, nerfstudio, viser and Rerun, in .venv/neighbours: viser needs
# an older rich than the tests' pins. nerfstudio pins older versions of the others; its exporter alone
# is run.
NEIGHBOURS := .venv/neighbours/bin/python
neighbours: $(NEIGHBOURS)
	$(NEIGHBOURS) tests/neighbours/check_neighbours.py

$(NEIGHBOURS):
	$(PYTHON) -m venv .venv/neighbours.new
	.venv/neighbours.new/bin/python -m pip install -q "$$(grep '^torch==' constraints.txt)"
	.venv/neighbours.new/bin/python -m pip install -q -e '.[sdk]' gsplat==1.5.3 viser==1.1.1 rerun-sdk==0.41.0
	.venv/neighbours.new/bin/python -m pip install -q --no-deps nerfstudio==1.1.5
	mv .venv/neighbours.new .venv/neighbours

# Write the repository's owner into every file that has the placeholder: make owner OWNER=name
owner:
	@test -n "$(OWNER)" || { echo "name the owner: make owner OWNER=name"; exit 2; }
	@grep -rlI --exclude-dir=.git --exclude-dir=.venv --exclude-dir=tests --exclude=Makefile --exclude=release.py OWNER/gsgen . | xargs -r sed -i.bak 's|OWNER/gsgen|$(OWNER)/gsgen|g'
	@find . -name '*.bak' -not -path './.venv/*' -delete

clean:
	rm -rf out build dist site .coverage .mypy_cache .pytest_cache .ruff_cache
