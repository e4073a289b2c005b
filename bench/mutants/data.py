"""What keeps everything that was recorded."""

from bench.mutants.fault import Fault

_FILE = "groundstation/recording/mcap_file.py"
_WRITER = "groundstation/recording/mcap_writer.py"
_TESTS = "tests/recording/test_mcap_writer.py"
_MANAGER = "groundstation/service/recording_manager.py"
_MANAGED = "tests/service/test_recording_manager.py"
_RECOVER = "groundstation/recording/recover.py"
_RECOVERED = "tests/recording/test_recover.py"

FAULTS = (
    Fault(
        "minority-of-copies-wins",
        "a damaged copy is taken for the sample",
        "groundstation/telemetry/main_chain.py",
        "if s.votes[slot, v] >= s.votes[slot, best]:",
        "if s.votes[slot, v] <= s.votes[slot, best]:",
        (
            "tests/telemetry/test_decoder.py::test_one_damaged_copy_of_four_is_never_taken_for_the_sample",
        ),
    ),
    Fault(
        "decoder-counts-loss",
        "the link is said to lose one sample more in every burst",
        "groundstation/telemetry/main_chain.py",
        "gap = int(s.place[slot]) - int(n[EMITTED]) - 1",
        "gap = int(s.place[slot]) - int(n[EMITTED])",
        (
            "tests/telemetry/test_statistics.py::test_loss_is_the_share_of_what_was_sent_and_bursts_are_told_apart",
        ),
    ),
    Fault(
        "radio-counts-loss",
        "a radio is said to lose one row less in every burst",
        "groundstation/links/log_rows.py",
        "lost = round((time_ms - self._last_ms) / self.period_ms) - 1",
        "lost = round((time_ms - self._last_ms) / self.period_ms) - 2",
        (
            "tests/links/test_log_rows.py::test_what_is_lost_is_counted_exactly_whichever_block_it_was_in",
        ),
    ),
    Fault(
        "inspect-counts-loss",
        "inspect counts one lost sample too many in every gap",
        "groundstation/telemetry/row_clock.py",
        "np.rint(step / period) - 1, 0)",
        "np.rint(step / period), 0)",
        ("tests/recording/test_quality.py::test_whatever_is_missing_is_counted_and_placed",),
    ),
    Fault(
        "writer-loses-a-row",
        "the last sample of each message is not in the file",
        "groundstation/recording/recording_file.py",
        "            message = batch[rows]\n",
        "            message = batch[slice(rows.start, max(rows.stop - 1, rows.start + 1))]\n",
        (f"{_TESTS}::test_everything_given_comes_back",),
    ),
    Fault(
        "overwrites",
        "an existing recording is overwritten",
        _FILE,
        "os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC",
        "os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC",
        (f"{_TESTS}::test_an_existing_file_is_never_overwritten",),
    ),
    Fault(
        "csv-overwrites",
        "convert overwrites a table",
        "groundstation/recording/csv_file.py",
        'path.open("x", encoding="ascii", newline="")',
        'path.open("w", encoding="ascii", newline="")',
        ("tests/recording/test_csv_file.py::test_an_existing_file_is_never_overwritten",),
    ),
    Fault(
        "chunk-without-checksum",
        "damage in a chunk cannot be told",
        _FILE,
        "enable_data_crcs=True",
        "enable_data_crcs=True, enable_crcs=False",
        (f"{_TESTS}::test_everything_given_comes_back",),
    ),
    Fault(
        "checksum-not-compared",
        "damaged data pass for data",
        "groundstation/recording/mcap_scan.py",
        "if len(content) != size or (crc is not None and zlib.crc32(content) != crc):",
        "if len(content) != size:",
        (f"{_RECOVERED}::test_a_bad_chunk_is_skipped_and_what_it_cost_is_told",),
    ),
    Fault(
        "no-flush",
        "a killed daemon loses all since the recording began",
        _WRITER,
        "            self._out.file.flush()\n            self._syncer",
        "            self._syncer",
        (f"{_TESTS}::test_what_came_a_moment_ago_is_in_the_file_while_the_recording_goes_on",),
    ),
    Fault(
        "no-sync",
        "a power loss takes what was recorded minutes ago",
        _WRITER,
        "                self._file.sync()",
        "                pass",
        (f"{_TESTS}::test_a_failing_sync_is_a_fault",),
    ),
    Fault(
        "finish-without-sync",
        "a power loss takes the end of a recording that was said to be finished",
        _FILE,
        "        os.fsync(self._stream.fd)\n        self.abandon()",
        "        self.abandon()",
        (f"{_TESTS}::test_the_name_of_a_new_file_and_the_whole_of_a_finished_one_are_on_the_disk",),
    ),
    Fault(
        "name-without-sync",
        "a power loss takes the name of a recording that was synced",
        _FILE,
        "            os.fsync(folder)",
        "            pass",
        (f"{_TESTS}::test_the_name_of_a_new_file_and_the_whole_of_a_finished_one_are_on_the_disk",),
    ),
    Fault(
        "half-a-record",
        "a full disk leaves half a record at the end",
        _FILE,
        "            os.ftruncate(self.fd, self.size)\n            raise",
        "            raise",
        (f"{_TESTS}::test_a_full_disk_keeps_every_whole_chunk_and_says_so_once",),
    ),
    Fault(
        "short-write",
        "what the disk did not take at once is not written",
        _FILE,
        "            while written < len(view):\n                written +=",
        "            if True:\n                written +=",
        (f"{_TESTS}::test_what_the_system_takes_in_pieces_is_written_whole",),
    ),
    Fault(
        "disk-filled-up",
        "a recording is not finished before the disk is full",
        _WRITER,
        "return file.free_bytes() < self._low_space_bytes + file.summary_bytes",
        "return False",
        (f"{_TESTS}::test_too_little_space_at_the_start_is_refused_and_leaves_no_file",),
    ),
    Fault(
        "drops-uncounted",
        "samples that the disk was too slow for are missing and nobody says so",
        _WRITER,
        "                self._dropped[type(item)] += _count(item)\n                return",
        "                return",
        (f"{_TESTS}::test_an_overflowing_queue_counts_what_it_drops_and_never_blocks",),
    ),
    Fault(
        "recover-loses-times",
        "recover gives messages other times than they had",
        _RECOVER,
        "file.add_message(channels[channel_id], log_ns, payload, publish_ns)",
        "file.add_message(channels[channel_id], publish_ns, payload, log_ns)",
        (f"{_RECOVERED}::test_a_file_of_another_program_keeps_all_it_has",),
    ),
    Fault(
        "recover-leaves-half",
        "a recovery that failed looks like one that did not",
        _RECOVER,
        "            output.unlink()",
        "            pass",
        (f"{_RECOVERED}::test_a_full_disk_leaves_no_half_a_file",),
    ),
    Fault(
        "recover-what-is-written",
        "a recording is repaired while it is being written",
        _RECOVER,
        "if is_held(path):",
        "if False:",
        (
            "tests/attack/test_recordings_folder.py::test_a_file_that_another_daemon_writes_is_recording_not_torn",
        ),
    ),
    Fault(
        "retention-deletes-the-newest",
        "the flights of today are deleted to keep those of last year",
        _MANAGER,
        "for name, size in sorted(found):",
        "for name, size in sorted(found, reverse=True):",
        (f"{_MANAGED}::test_the_oldest_go_first_and_no_more_of_them_than_must",),
    ),
    Fault(
        "retention-deletes-what-is-written",
        "a file that another daemon writes is deleted",
        _MANAGER,
        "        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)\n        path.unlink()",
        "        path.unlink()",
        (f"{_MANAGED}::test_what_another_daemon_writes_is_not_deleted_and_holds_nothing_up",),
    ),
    Fault(
        "retention-deletes-others",
        "files that are none of ours are deleted",
        _MANAGER,
        "if OUR_NAME.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):",
        "if entry.is_file(follow_symlinks=False):",
        (f"{_MANAGED}::test_the_oldest_recordings_give_way_and_nothing_else_does",),
    ),
    Fault(
        "frame-checksum-not-compared",
        "damage on a serial line passes for a packet",
        "groundstation/telemetry/framing.py",
        'if crc16(packet) != int.from_bytes(checksum, "little"):',
        "if False:",
        (
            "tests/telemetry/test_framing.py::test_any_single_flipped_bit_costs_its_frame_and_at_most_the_next",
        ),
    ),
)
