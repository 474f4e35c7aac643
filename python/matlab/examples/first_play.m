% Play an edge, and print when it began and ended. MEISSNER_URL is the daemon's address.
addpath(fullfile(fileparts(mfilename('fullpath')), '..'));
m = Meissner(getenv('MEISSNER_URL'), 'token', getenv('MEISSNER_TOKEN'));
m.arm('assume_rest', true, 'checked', 'example');
play = m.play('edge-45', 'seconds', 0.3, 'at', m.now() + 1.5, 'scale', 0.8);
receipt = m.wait(play);
fprintf('onset %.6f s, known to %.0f us\n', receipt.onset.time, 1e6 * receipt.onset.uncertainty);
fprintf('offset %.6f s, tick %.0f\n', receipt.offset.time, receipt.offset.tick);
m.close();
