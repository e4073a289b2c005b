"""What keeps strangers out."""

from bench.mutants.fault import Fault

_LEASE = "groundstation/service/lease.py"
_SOCKET = "groundstation/service/control_socket.py"
_CONTROL = "groundstation/service/control.py"
_PAGE = "groundstation/page/access.py"
_PAGE_TESTS = "tests/page/test_access.py"
_RULES = "tests/page/test_access_rules.py"
_LIMITS = "tests/service/test_control_limits.py"

FAULTS = (
    Fault(
        "lease-token",
        "whoever knows of a client can command in its place",
        _LEASE,
        "hmac.compare_digest(self.token.encode(), token.encode())",
        "True",
        (
            "tests/service/test_commander.py::test_two_clients_cannot_both_command",
            "tests/service/test_commander.py::test_nothing_leaves_without_an_authorised_client",
        ),
    ),
    Fault(
        "socket-mode",
        "every user of the machine can command",
        _SOCKET,
        "before = os.umask(0o177)",
        "before = os.umask(0)",
        (
            f"{_LIMITS}::test_another_user_cannot_reach_the_socket",
            "tests/system/test_run.py::test_only_its_owner_can_reach_the_socket",
        ),
    ),
    Fault(
        "lock-of-another",
        "the lock file can be somebody else's",
        _SOCKET,
        "os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600",
        "os.O_RDWR | os.O_CREAT | os.O_NONBLOCK, 0o600",
        ("tests/attack/test_local_users.py::test_a_lock_file_is_never_somebody_elses",),
    ),
    Fault(
        "request-without-limit",
        "one request takes all memory",
        _CONTROL,
        "        if len(content) > BODY_MOST:",
        "        if False:",
        (f"{_LIMITS}::test_a_request_that_is_too_large_is_refused",),
    ),
    Fault(
        "page-token-twice",
        "the address of the page lets a second browser in",
        "groundstation/service/page.py",
        "                self._tokens.remove(known)\n",
        "",
        (_RULES,),
    ),
    Fault(
        "page-token-any",
        "any address lets a browser in",
        "groundstation/service/page.py",
        "if secrets.compare_digest(known.encode(), token.encode()):",
        "if True:",
        (_RULES,),
    ),
    Fault(
        "page-key-for-all",
        "every user of the machine can make a cookie",
        "groundstation/service/page.py",
        "os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)",
        "os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)",
        (_RULES,),
    ),
    Fault(
        "cookie-unsigned",
        "a cookie that somebody made up lets a browser in",
        _PAGE,
        'return _same(signature, self._sign("session", name))',
        "return bool(signature)",
        (_RULES,),
    ),
    Fault(
        "host-not-compared",
        "a site whose name leads here reads the flight",
        _PAGE,
        "return host.lower() in self._hosts",
        "return True",
        (_RULES,),
    ),
    Fault(
        "origin-not-compared",
        "a page of any site can stop the motors",
        _PAGE,
        'ours = self.knows_host(host) and origin.lower() == f"http://{host.lower()}"',
        "ours = self.knows_host(host)",
        (_RULES,),
    ),
    Fault(
        "change-token-not-compared",
        "a forged request changes something",
        _PAGE,
        'return ours and _same(headers.get("x-change-token", ""), self.change_token(cookie))',
        "return ours",
        (_RULES,),
    ),
    Fault(
        "page-gives-any-file",
        "the page gives out files that are no recordings",
        "groundstation/page/app.py",
        'if name in [one["file"] for one in ask(control, "GET", "/recordings")]:',
        "if True:",
        (f"{_PAGE_TESTS}::test_only_files_that_the_daemon_lists_are_given_out",),
    ),
    Fault(
        "replay-of-any-file",
        "a request replays a file outside the recordings folder",
        "groundstation/service/api.py",
        "if not path.is_relative_to(folder.resolve()):",
        "if False:",
        (
            "tests/service/test_link_switch.py::test_no_path_of_a_request_leaves_the_recordings_folder",
        ),
    ),
    Fault(
        "port-of-any-path",
        "a request opens what is no serial port",
        "groundstation/service/api.py",
        'if not path.is_relative_to("/dev") or any(map(path.is_relative_to, _FOR_ALL)):',
        "if False:",
        (
            "tests/attack/test_local_users.py::test_a_request_reaches_no_port_by_way_of_a_folder_for_all",
        ),
    ),
    Fault(
        "job-on-any-file",
        "a job reads a file outside the recordings folder",
        "groundstation/service/jobs.py",
        "if Path(name).name != name or not (folder / name).is_file():",
        "if not (folder / name).is_file():",
        ("tests/service/test_jobs.py::test_no_name_leads_out_of_the_recordings_folder",),
    ),
    Fault(
        "effects-run-unasked",
        "a model from a stranger runs its program",
        "groundstation/dynamics/trust.py",
        'if os.environ.get(CONSENT, "") not in (ALL, digest):',
        "if False:",
        ("tests/attack/test_own_effects.py::test_consent_is_asked_once_for_each_content",),
    ),
    Fault(
        "terminal-obeys",
        "a recording writes to the terminal what it likes",
        "groundstation/text.py",
        "return _CONTROLS.sub(lambda found: ascii(found[0])[1:-1], text)",
        "return text",
        ("tests/attack/test_terminal.py::test_events_of_a_daemon_are_one_tame_line_each",),
    ),
)
