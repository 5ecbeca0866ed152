# make · make small · make paper · make concealed · make concealed_final · make demo-capture · make test · make test-long · make durations · make coverage · make rehearse · make cluster · make lint · make docs · make gallery · make real · make bench · make accuracy · make clean
# Needs Python 3.11 or 3.12 (PYTHON=… picks one); after the installs nothing needs the network.

BIN := .venv/bin
CORES ?= 2
EITSKIN_DATA ?= ../shared/data
SNAKEMAKE := $(BIN)/snakemake --cores $(CORES)
# One run at a time; a second waits, and clears the lock that a killed one left behind.
# No process of flock's own: Ctrl-C would end it before the arm is lifted.
RUN = sh -c 'flock -n .venv/run.lock true || echo "eitskin: another run is going on in this folder; waiting for its end"; \
	exec flock --no-fork .venv/run.lock sh -c "$$0" make "$$@"' \
	'$(SNAKEMAKE) --unlock --quiet all && exec $(SNAKEMAKE) "$$@"'

# Every row of Table I.
ROWS = --configfile workflow/config/paper.yaml
FULL = $(ROWS) workflow/config/full.yaml

PYTEST = $(BIN)/python -m pytest -n $(CORES) --dist loadgroup
LONG = -m '(hypothesis or long) and not rehearsal' --hypothesis-profile search
SHARD ?= commit

# What `make demo-capture` makes of its capture.
DEMO = --configfile workflow/config/demo_capture.yaml
DEMO_REPORT := results/diagnosis/emulated-rig/report.html

# What `make real` judges besides Table I, what it says of it, and what must be called unusable.
REAL := results/diagnosis/diagnosed.csv results/diagnosis/tanks.csv
SAID := results/diagnosis/diagnosed.csv results/diagnosis/*-tank/held_out_pairs.txt
BROKEN = $(EITSKIN_DATA)/pyeidors-tank/measurements/EIT_DEV_Test/2025-09-23-00-01-56_10_10.00_100uA_2000Hz.csv

export EITSKIN_DATA
export OMP_NUM_THREADS = 1
export OPENBLAS_NUM_THREADS = 1
export MKL_NUM_THREADS = 1
# Tests start hundreds of processes; none need compile what another has compiled.
export PYTHONDONTWRITEBYTECODE =

.DELETE_ON_ERROR:
.PHONY: run small paper concealed concealed_final demo-capture test test-long durations coverage rehearse cluster lint docs gallery real bench mutants accuracy clean

run: .venv/installed
	@echo "eitskin: simulating, training and diagnosing on $(CORES) cores; Ctrl-C stops it, make again goes on"
	@$(RUN)
	@echo "eitskin: results/tables/table_1.md, results/concealed/demo/score/score.md"
	@echo "eitskin: the paper's tables and figures: $(SNAKEMAKE) table_1 table_2 figure_1 figure_2 figure_3 figure_4"

small: .venv/installed
	@echo "eitskin: every row of Table I from 6,000 samples on $(CORES) cores"
	@$(RUN) $(ROWS) --config budget=small

paper: .venv/installed
	@echo "eitskin: reproducing the paper's tables and figures on $(CORES) cores, hours; what is done stays; results/report.html"
	@$(RUN) paper $(FULL) && $(SNAKEMAKE) paper $(FULL) --report results/report.html

concealed: .venv/installed
	@echo "eitskin: concealing effects, diagnosing them unseen, opening the truths, on $(CORES) cores"
	@$(RUN) concealed

concealed_final: .venv/installed
	@echo "eitskin: the final block of concealed effects on $(CORES) cores, hours; what is done stays"
	@$(RUN) concealed --config "concealed={block: final}"

demo-capture: .venv/installed-rig
	@echo "eitskin: capturing 24 places with 3 probes from an emulated rig, minutes; Ctrl-C and again: it goes on"
	@$(BIN)/python -m rigsim.during workflow/config/rigsim.yaml $(RUN) capture $(DEMO)
	@echo "eitskin: learning from the capture and diagnosing it"
	@$(RUN) table_1 $(DEMO_REPORT) $(DEMO)
	@cat results/tables/table_1.md
	@echo "recording and manifest: results/recordings/emulated-rig.parquet, .manifest.json"
	@echo "journal: captures/emulated-rig.jsonl; what the emulator saw: results/rig/events.jsonl"
	@echo "Table I of this capture alone: results/tables/table_1.md; the next \`make\` writes the whole again"
	@echo "diagnosis: $(DEMO_REPORT)"
	@echo "to capture anew: rm captures/emulated-rig.jsonl results/recordings/emulated-rig.*"

test: .venv/installed-test
	@echo "eitskin: testing"
	@$(PYTEST)

# Properties on examples that no run has seen, and what takes long. The seed draws them again.
# Commits take its shards in turn; SHARD=all tests all, SHARD=2 the second.
test-long: .venv/installed-test
	@seed=$${SEED:-$$(od -An -N4 -tu4 /dev/urandom | tr -d ' ')}; \
	echo "eitskin: searching properties and testing what takes long; again: make test-long SHARD=$(SHARD) SEED=$$seed"; \
	$(PYTEST) $(LONG) --shard $(SHARD) --hypothesis-seed $$seed

durations: .venv/installed-test
	@echo "eitskin: measuring what every test costs, an hour; tests/durations.csv"
	@$(PYTEST) --renew-durations test
	@$(PYTEST) $(LONG) --hypothesis-seed 0 --renew-durations long

# Of the fast tests; TESTS=tests/unit/data: of a part of them.
coverage: .venv/installed-test
	@echo "eitskin: measuring what the fast tests run, longer than they take; the least covered modules first"
	@$(PYTEST) -q --cov --cov-report= $(TESTS)
	@$(BIN)/python -m coverage report | sed -n '1,42p;/^TOTAL/p'

rehearse: .venv/installed-test
	@echo "eitskin: rehearsing the rig's faults with the real ur_rtde, minutes; keep the machine free meanwhile"
	@$(BIN)/python -m pytest -m rehearsal tests/rig tests/workflow

# Slurm is skipped in a sentence where there is none.
cluster: .venv/installed-cluster
	@echo "eitskin: running the tiny workflow with a bucket in place of a disk, and on a Slurm of two nodes of this machine, minutes"
	@$(BIN)/python -m pytest -m cluster tests/workflow

lint: .venv/installed-test
	@echo "eitskin: checking style and types"
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/snakefmt --check Snakefile workflow/rules
	@$(BIN)/snakemake --lint
	@$(BIN)/snakemake --lint $(DEMO)

docs: .venv/installed-docs
	@echo "eitskin: building the documentation; results/documentation/index.html"
	@$(BIN)/sphinx-build -q -W --keep-going -b html -d results/documentation/.doctrees docs results/documentation

gallery: .venv/installed-test
	@echo "eitskin: simulating and diagnosing the recordings of the gallery that are not there, ten minutes; docs/gallery"
	@mkdir -p docs/gallery
	@$(BIN)/python -m manual.gallery docs/gallery
	@$(BIN)/python -m manual

real: .venv/installed
	@if [ ! -d "$(EITSKIN_DATA)" ]; then \
	  echo "SKIPPED: no real recordings at $(EITSKIN_DATA); set EITSKIN_DATA"; \
	else \
	  echo "eitskin: learning from the real recordings in $(EITSKIN_DATA)"; \
	  $(RUN) all $(REAL) --configfile workflow/config/real.yaml && cat $(SAID) \
	    && $(BIN)/python -m proof.objects results/objects \
	    && { $(BIN)/eitskin check "$(BROKEN)"; [ $$? -eq 2 ]; }; \
	fi

bench: .venv/installed-test
	@echo "eitskin: timing against pyEIT, SciPy and limits; benchmarks/README.md; keep the machine free meanwhile"
	@$(BIN)/python -m benchmark.speed
	@$(BIN)/python -m benchmark.page

mutants: .venv/installed-test
	@echo "eitskin: making rules that decide wrong, one by one; some minutes"
	@$(BIN)/python -m benchmark.mutants benchmarks/mutants.yaml

accuracy: .venv/installed-test
	@echo "eitskin: measuring the forward model's numerical error"
	@$(BIN)/python -m benchmark.accuracy
	@$(BIN)/python -m benchmark.outlines

# Not captures: nothing makes them again.
clean:
	rm -rf logs .snakemake
	[ ! -d results ] || find results -mindepth 1 -maxdepth 1 ! -name README.md -exec rm -rf {} +

# A folder `.venv/installing` that is still there tells of a killed install: it starts anew.
define install
	@set -e; \
	if [ -e .venv/installing ] || [ ! -x $(BIN)/python ]; then \
	  python=; \
	  for candidate in $(PYTHON) python3.11 python3.12 python3; do \
	    if $$candidate -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' 2>/dev/null; \
	    then python=$$candidate; break; fi; \
	  done; \
	  if [ -z "$$python" ]; then echo "eitskin: Python 3.11 or 3.12 is needed; PYTHON=… names one"; exit 1; fi; \
	  echo "eitskin: making .venv with $$python"; \
	  $$python -m venv --clear .venv; \
	fi; \
	mkdir .venv/installing; \
	if [ -t 1 ]; then quiet=; else quiet=--quiet; fi; \
	echo "eitskin: installing $(1) with pinned versions, minutes"; \
	$(BIN)/python -m pip install $$quiet --disable-pip-version-check -c envs/requirements.lock -e '$(1)'; \
	rmdir .venv/installing; \
	touch $@
endef

.venv/installed: pyproject.toml envs/requirements.lock
	$(call install,.[workflow])

.venv/installed-rig: pyproject.toml envs/requirements.lock | .venv/installed
	$(call install,.[rig])

.venv/installed-docs: pyproject.toml envs/requirements.lock | .venv/installed
	$(call install,.[docs])

.venv/installed-test: pyproject.toml envs/requirements.lock | .venv/installed
	$(call install,.[test])

.venv/installed-cluster: pyproject.toml envs/requirements.lock | .venv/installed-test
	$(call install,.[cluster])
